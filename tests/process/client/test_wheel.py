"""`pip install zarm` is enough for `import zarm`: the wheel and what it needs by itself, and nothing of the planner."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
import venv
import zipfile
from importlib.metadata import distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from support.harness import PATIENCE
from support.paths import ROOT

OF_THE_PLANNER = ("fcl", "numba", "torch", "trimesh")


def needed(requirements: list[str]) -> set[str]:
    """The names of all distributions that these requirements bring, as the installed ones declare it."""
    names: set[str] = set()
    waiting = [Requirement(line) for line in requirements]
    while waiting:
        requirement = waiting.pop()
        wanted = requirement.marker is None or requirement.marker.evaluate({"extra": ""})
        if wanted and requirement.name not in names:
            names.add(requirement.name)
            waiting += map(Requirement, distribution(requirement.name).requires or [])
    return names


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Python of an environment that holds the wheel of zarm and its core dependencies, as they are installed here."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-build-isolation", "--no-deps", "--no-index"]
    subprocess.run([*build, "--wheel-dir", str(folder), str(ROOT)], check=True, capture_output=True)
    (wheel,) = folder.glob("zarm-*.whl")
    venv.create(folder / "venv", with_pip=False)
    (packages,) = (folder / "venv").glob("lib/python*/site-packages")
    zipfile.ZipFile(wheel).extractall(packages)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    for name in needed(project["dependencies"]):
        for file in distribution(name).files or []:
            if ".." not in file.parts and file.suffix != ".pyc":
                place = packages / file
                place.parent.mkdir(parents=True, exist_ok=True)
                place.symlink_to(Path(str(file.locate())).resolve())
    return folder / "venv" / "bin" / "python"


def run(python: Path, *arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    environment = {key: value for key, value in os.environ.items() if not key.startswith(("ZARM_", "PYTHON"))}
    return subprocess.run(
        [python, "-W", "error", *arguments],
        env=environment | variables,
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        cwd="/",
    )


def test_nothing_of_the_planner_is_there(python: Path) -> None:
    look = f"from importlib.util import find_spec; print([name for name in {OF_THE_PLANNER} if find_spec(name)])"
    assert run(python, "-c", look).stdout.strip() == "[]"


@pytest.mark.slow  # the example itself is run in test_examples.py
def test_a_program_plans_and_moves(python: Path, place: str, empty_scene: None) -> None:
    done = run(python, str(ROOT / "examples" / "01_plan.py"), ZARM_CONNECT=place)
    assert done.returncode == 0, done.stderr
    assert "succeeded" in done.stdout


def test_the_client_is_typed_and_light(python: Path) -> None:
    look = "import sys, zarm; from pathlib import Path; assert Path(zarm.__file__).with_name('py.typed').exists(); print(*sys.modules)"
    done = run(python, "-c", look)
    assert done.returncode == 0, done.stderr
    assert {"asyncio", "mcap", "numpy", "rich", "typer", "yaml"} & set(done.stdout.split()) == set()
