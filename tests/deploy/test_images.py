"""What the images hold, and what they do not."""

from __future__ import annotations

import json
import tomllib

import pytest

from support.deploy.composition import docker, image
from support.paths import ROOT

EXTRAS = {"numba", "fcl", "rclpy", "curobo_msgs"}
OWN = {
    "router": set(),
    "executor": set(),
    "planner": {"numba", "fcl"},
    "servo": {"numba", "fcl"},
    "perception": {"numba", "fcl"},
    "ros_bridge": {"rclpy", "curobo_msgs"},
    "leeloo_sim": {"rclpy", "curobo_msgs"},
}
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
READ_ONLY = ("--read-only", "--volume=/var/lib/zarm", "--tmpfs=/tmp", "--network=none", "--cap-drop=ALL")
every_image = pytest.mark.parametrize("service", OWN)


def said(service: str, *command: str, options: tuple[str, ...] = ()) -> str:
    """What a command says in a fresh container of an image."""
    program, *arguments = command
    return docker(
        "run", "--rm", "--no-healthcheck", *options, f"--entrypoint={program}", image(service), *arguments
    ).stdout.strip()


@every_image
def test_an_image_holds_its_own_extra_and_no_other(service: str) -> None:
    modules = sorted(EXTRAS | {"torch", "pytest", "pip", "hatchling"})
    script = f"import importlib.util as u; print(*(m for m in {modules} if u.find_spec(m)))"
    assert set(said(service, "python", "-c", script).split()) == OWN[service]


@every_image
def test_an_image_holds_no_compiler_no_tests_and_nothing_secret(service: str) -> None:
    assert said(service, "sh", "-c", "command -v cc c++ gcc make pip || true") == ""
    assert said(service, "find", "/opt/zarm", "-name", "tests", "-o", "-name", "*.key") == ""
    assert said(service, "find", "/certs", "/robots", "/var/lib/zarm", "/tmp", "-type", "f") == ""


@every_image
def test_an_image_is_labelled_and_runs_without_root(service: str) -> None:
    config = json.loads(docker("image", "inspect", "-f", "{{json .Config}}", image(service)).stdout)
    assert config["Labels"]["org.opencontainers.image.version"] == PROJECT["version"]
    assert config["Labels"]["org.opencontainers.image.licenses"] == PROJECT["license"]
    assert config["StopSignal"] == "SIGTERM"
    assert config["Healthcheck"]["Test"]
    assert said(service, "python", "-c", "import os; print(os.getuid() > 0)") == "True"
    version = "import importlib.metadata as m; print(m.version('zarm'))"
    assert said(service, "python", "-c", version) == PROJECT["version"]


@every_image
def test_the_files_of_an_image_belong_to_somebody_else(service: str) -> None:
    assert said(service, "find", "/opt/zarm", "-writable", "-not", "-type", "l") == ""


def test_the_planner_image_uses_its_compiled_kernels() -> None:
    options = (*READ_ONLY, "--env=NUMBA_DEBUG_CACHE=1")
    reported = said("planner", "python", "-m", "zarm_planner.warm_up", options=options)
    assert "data loaded from '/var/lib/zarm/kernels" in reported
    assert "data saved" not in reported


def test_on_another_cpu_the_planner_compiles_and_keeps_kernels() -> None:
    script = """
import numpy as np
from zarm_contract.robot import load_robot
from zarm_geometry.robot_model import RobotModel
model = RobotModel.of(load_robot("doosan_m1013"))
print(model.fk_tip(np.array(model.robot.descriptor.home)))
"""
    cpu = ("--env=NUMBA_CPU_NAME=x86-64", "--env=NUMBA_CPU_FEATURES=", "--env=NUMBA_DEBUG_CACHE=1")
    reported = said("planner", "python", "-c", script, options=(*READ_ONLY, *cpu))
    assert "data saved to '/var/lib/zarm/kernels" in reported
