"""deploy/compose.yaml started as a project of a test's own, and queries to it from outside."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
import uuid
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from support.command_line import environment, zarm
from support.harness import free_endpoint
from support.paths import ROOT

DEPLOY = ROOT / "deploy"
SERVICES = ("router", "planner", "servo", "executor", "ros_bridge")
TAG = os.environ.get("ZARM_TAG", "0.1.0")
PATIENCE = 240.0
"""Seconds until a test gives up waiting for a container."""
_PACE = 0.5
"""Interval (s) at which a container is checked, since a check costs a process."""


def docker(*arguments: str, check: bool = True, given: str | None = None) -> subprocess.CompletedProcess[str]:
    """`docker` with these arguments; `given` is its standard input. With `check`, the test fails if it fails."""
    done = subprocess.run(["docker", *arguments], input=given, capture_output=True, text=True, timeout=PATIENCE)
    assert not check or done.returncode == 0, f"docker {' '.join(arguments)}: {done.stdout}{done.stderr}"
    return done


def _in_time(probe: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + PATIENCE
    while not probe():
        assert time.monotonic() < deadline, f"waited {PATIENCE:g} s in vain until {what}"
        time.sleep(_PACE)


def image(service: str) -> str:
    """The image of a service."""
    return f"zarm-{service.replace('_', '-')}:{TAG}"


class Composition:
    """A project with a name and a port of its own; use it in `with`. Leaving takes it down with its volumes."""

    def __init__(self, *files: str) -> None:
        self.project = f"zarm-test-{uuid.uuid4().hex[:8]}"
        self.endpoint = free_endpoint()
        self._files = [word for file in ("compose.yaml", *files) for word in ("-f", str(DEPLOY / file))]
        self._settings = {
            "COMPOSE_PROJECT_NAME": self.project,
            "ZARM_PORT": self.endpoint.rpartition(":")[2],
            "ZARM_TAG": TAG,
            "ZARM_HEALTH_INTERVAL": "5s",
            "ROS_DOMAIN_ID": "0",
        }
        plugin = docker("compose", "version", check=False).returncode == 0
        self._command = ["docker", "compose"] if plugin else ["docker-compose"]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None:
            sys.stdout.write(self.compose("--profile", "sim", "logs", "--no-color", "--tail=40", check=False))
        self.down()

    def compose(self, *arguments: str, check: bool = True, **settings: str) -> str:
        """Standard output of compose with these arguments."""
        done = subprocess.run(
            [*self._command, *self._files, *arguments],
            env=environment() | self._settings | settings,
            capture_output=True,
            text=True,
            timeout=PATIENCE,
        )
        assert not check or done.returncode == 0, f"compose {' '.join(arguments)}: {done.stdout}{done.stderr}"
        return done.stdout

    def up(self, *services: str, profile: str | None = None, **settings: str) -> None:
        """Start it, or change it to these settings, until every container is healthy."""
        chosen = () if profile is None else ("--profile", profile)
        self.compose(*chosen, "up", "-d", *services, **settings)
        for service in services or (*SERVICES, *(("leeloo_sim",) if profile == "sim" else ())):
            self.wait_healthy(service)

    def down(self) -> None:
        """Take down what is running, and its volumes."""
        self.compose("--profile", "sim", "down", "-v", "--remove-orphans")

    def left(self) -> list[str]:
        """Containers, networks and volumes of the project."""
        label = f"label=com.docker.compose.project={self.project}"
        kinds = (("ps", "-a"), ("network", "ls"), ("volume", "ls"))
        return [line for kind in kinds for line in docker(*kind, "-q", "--filter", label).stdout.split()]

    def container(self, service: str) -> Any:
        """The engine's data on the container of a service."""
        label = f"label=com.docker.compose.service={service}"
        ours = f"label=com.docker.compose.project={self.project}"
        (name,) = docker("ps", "-a", "-q", "--filter", label, "--filter", ours).stdout.split()
        (found,) = json.loads(docker("inspect", name).stdout)
        return found

    def wait_healthy(self, service: str) -> None:
        """Wait until the health check of a service succeeds."""
        _in_time(
            lambda: self.container(service)["State"].get("Health", {}).get("Status") == "healthy",
            f"{service} is healthy",
        )

    def crash(self, service: str) -> None:
        """Kill a service as in a crash, and wait until it is up again.

        `docker kill` is unsuitable: the engine takes it as a request that the service stays down.
        """
        before = self.container(service)
        kill = f"import os; os.kill({before['State']['Pid']}, 9)"
        docker(
            "run",
            "--rm",
            "--no-healthcheck",
            "--pid=host",
            "--user=0",
            "--entrypoint=python",
            image("router"),
            "-c",
            kill,
        )
        _in_time(lambda: self.container(service)["RestartCount"] > before["RestartCount"], f"{service} restarts")
        self.wait_healthy(service)

    def inside(self, service: str, *command: str, check: bool = True) -> str:
        """The output of a command in the container of a service."""
        return docker("exec", self.container(service)["Id"], *command, check=check).stdout.strip()

    def ros_client(self, script: Path) -> Any:
        """The JSON printed by a script that runs on ROS, in a container of its own beside the others."""
        words = [
            "run",
            "--rm",
            "-i",
            "--network",
            f"{self.project}_default",
            "--entrypoint=python",
            image("ros_bridge"),
        ]
        return json.loads(docker(*words, "-", given=script.read_text()).stdout)

    def zarm(self, *arguments: str, **variables: str) -> str:
        """The output of `zarm` on this machine, connected to the published port; it must succeed."""
        done = zarm(*arguments, ZARM_CONNECT=self.endpoint, **variables)
        assert done.returncode == 0, f"zarm {' '.join(arguments)}: {done.stdout}{done.stderr}"
        return done.stdout
