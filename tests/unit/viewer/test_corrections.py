"""Corrections reach the descriptor's file, and nothing else in it changes."""

from __future__ import annotations

import dataclasses
import difflib
import shutil
from pathlib import Path

import pytest

from zarm_contract.collision import CollisionSphere
from zarm_contract.errors import InvalidRequest
from zarm_contract.robot import ROBOTS, RobotDescription, load_robot
from zarm_viewer.corrections import Corrections


def copied(name: str, folder: Path) -> RobotDescription:
    for suffix in (".yaml", ".urdf"):
        shutil.copy(ROBOTS / f"{name}{suffix}", folder)
    return load_robot(str(folder / f"{name}.yaml"))


def changed(before: str, after: str) -> list[str]:
    lines = difflib.unified_diff(before.splitlines(), after.splitlines(), lineterm="", n=0)
    return [line for line in lines if line[0] in "+-" and line[:3] not in ("+++", "---")]


@pytest.mark.lengthy
@pytest.mark.parametrize("name", ["doosan_m1013", "panda"])
def test_a_correction_is_read_back_and_exact_geometry_stays(name: str, tmp_path: Path) -> None:
    robot = copied(name, tmp_path)  # its spheres are aliases of its exact geometry
    was = Corrections.of(robot.descriptor)
    link = next(iter(was.spheres))
    spheres = {**was.spheres, link: (*was.spheres[link], CollisionSphere(center=(0.0, 0.0, 0.1), radius=0.05))}
    wanted = Corrections(tuple(joint + 0.01 for joint in was.home), spheres, was.ignored[1:])
    made = wanted.write(robot)
    assert Corrections.of(made.descriptor) == wanted
    assert made.descriptor.collision == robot.descriptor.collision
    assert sorted(file.name for file in tmp_path.iterdir()) == [f"{name}.urdf", f"{name}.yaml"]


def test_comments_and_other_sections_stay_as_they_are(tmp_path: Path) -> None:
    robot = copied("ur5e", tmp_path)
    was = Corrections.of(robot.descriptor)
    before = robot.path.read_text()
    pairs = "\n".join(f"  - [{a}, {b}]  # reason {i}" for i, (a, b) in enumerate(was.ignored))
    begin, end = before.index("self_collision_ignore:"), before.index("\n", before.rindex("  - ["))
    before = f"{before[:begin]}self_collision_ignore:\n{pairs}{before[end:]}"
    robot.path.write_text(before)
    dataclasses.replace(was, ignored=was.ignored[:-1], home=(0.1, *was.home[1:])).write(load_robot(str(robot.path)))
    gone, home = pairs.splitlines()[-1], next(line for line in before.splitlines() if line.startswith("home:"))
    assert changed(before, robot.path.read_text()) == [f"-{home}", f"+{home.replace('0.0', '0.1', 1)}", f"-{gone}"]


def test_a_file_that_somebody_else_has_changed_stays(tmp_path: Path) -> None:
    robot = copied("ur5e", tmp_path)
    theirs = robot.path.read_text().replace("home: [0.0", "home: [0.2")
    robot.path.write_text(theirs)
    with pytest.raises(InvalidRequest, match="has changed since"):
        Corrections.of(robot.descriptor).write(robot)
    assert robot.path.read_text() == theirs


def test_a_home_outside_of_the_limits_is_refused_with_its_place(tmp_path: Path) -> None:
    robot = copied("ur5e", tmp_path)
    before = robot.path.read_text()
    was = Corrections.of(robot.descriptor)
    with pytest.raises(InvalidRequest, match=r"ur5e\.yaml:\d+: home\.0: 9\.0 is outside the limits"):
        dataclasses.replace(was, home=(9.0, *was.home[1:])).write(robot)
    assert robot.path.read_text() == before
    assert sorted(file.name for file in tmp_path.iterdir()) == ["ur5e.urdf", "ur5e.yaml"]
