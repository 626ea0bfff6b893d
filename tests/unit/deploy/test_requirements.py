"""What the images of deploy/ install is what zarm is tested with; `make requirements` brings the files up to date."""

from __future__ import annotations

import re
import tomllib
from importlib.metadata import PackageNotFoundError, requires

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from support.paths import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
EXTRAS = {
    "executor": ("metrics",),
    "planner": ("metrics", "planner"),
    "viewer": ("metrics", "viewer"),
    "ros_bridge": ("metrics", "ros"),
    "ros_build": ("ros", "ros-messages"),
}
FILES = [*EXTRAS, "wheel"]
GENERATES_ONLY = {"empy"}
"""What ROS declares and only the generation of messages imports: PyPI has no wheel of it."""

ENTRY = re.compile(
    r"^(?P<name>[\w.-]+)==(?P<version>\S+)(?P<hashes>(?: \\\n    --hash=sha256:[0-9a-f]{64})+)\n", re.MULTILINE
)


def pins(text: str) -> dict[str, str]:
    """Versions by name, as the constraints give them."""
    found = re.findall(r"^([\w.-]+)==(\S+)", text, re.MULTILINE)
    return {canonicalize_name(name): version for name, version in found}


def text_of(name: str) -> str:
    return (ROOT / "deploy" / "requirements" / f"{name}.txt").read_text()


def closure(wanted: list[str]) -> set[str]:
    """Names of all that these requirements bring, as the installed packages declare it."""
    names: set[str] = set()
    waiting = [Requirement(line) for line in wanted]
    seen: set[tuple[str, str]] = set()
    while waiting:
        requirement = waiting.pop()
        name = canonicalize_name(requirement.name)
        for extra in requirement.extras | {""}:
            if (name, extra) in seen:
                continue
            seen.add((name, extra))
            names.add(name)
            waiting += [
                needed
                for needed in map(Requirement, requires(name) or [])
                if needed.marker is None or needed.marker.evaluate({"extra": extra})
            ]
    return names


@pytest.mark.lengthy
@pytest.mark.parametrize("image", EXTRAS)
def test_an_image_installs_exactly_what_its_service_needs(image: str) -> None:
    project = PROJECT["project"]
    declared = project["dependencies"] + [
        line for extra in EXTRAS[image] for line in project["optional-dependencies"][extra]
    ]
    try:
        needed = closure(declared)
    except PackageNotFoundError as absent:
        pytest.skip(f"{absent.name} is not installed here, so what it needs is not known: make ros")
    left_out = GENERATES_ONLY if image == "ros_bridge" else set()
    assert set(pins(text_of(image))) == needed - left_out


@pytest.mark.parametrize("file", FILES)
def test_images_have_the_tested_package_versions(file: str) -> None:
    constraints = pins((ROOT / "constraints.txt").read_text())
    installed = pins(text_of(file))
    assert installed
    assert installed == {name: constraints.get(name) for name in installed}


@pytest.mark.parametrize("file", FILES)
def test_nothing_is_installed_whose_hash_is_not_known(file: str) -> None:
    text = text_of(file)
    entries = ENTRY.findall(text)
    rest = [line for line in ENTRY.sub("", text).splitlines() if line and not line.lstrip().startswith("#")]
    assert len(entries) == len(pins(text))
    assert not rest, "a line that is no package with its hashes"
    assert "://" not in text, "where packages come from is a setting of the machine that builds"


def test_the_wheel_of_zarm_is_built_by_what_the_project_names() -> None:
    named = {canonicalize_name(Requirement(line).name) for line in PROJECT["build-system"]["requires"]}
    assert named <= set(pins(text_of("wheel")))
