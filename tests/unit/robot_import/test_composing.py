"""Several robots become one: their names, their places, their grippers, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from support.composed import TORSO, TWO_PANDAS, composed, torso_with_arms, two_pandas
from support.planner.small_arm import small_arm
from zarm_contract.errors import InvalidRequest
from zarm_contract.robot import load_robot
from zarm_geometry.exact import ExactScene
from zarm_geometry.frames import matrix
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_robot_import.checking import findings
from zarm_robot_import.composing import compose


def test_two_arms_stand_where_the_file_says(tmp_path: Path) -> None:
    both, one = RobotModel.of(load_robot(str(two_pandas(tmp_path)))), RobotModel.of(load_robot("panda"))
    rng = np.random.default_rng(0)
    for _ in range(20):
        q = rng.uniform(both.lower, both.upper)
        for name, joints, y in (("left", q[:7], 0.3), ("right", q[7:], -0.3)):
            for link in ("panda_link0", "panda_link4", "panda_hand", "panda_grasptarget"):
                there = both.fk_link(f"{name}_{link}", q)
                assert np.allclose(there, matrix((0.0, y, 0.0)) @ one.fk_link(link, joints), atol=1e-9)


def test_an_arm_on_another_moves_with_its_tip(tmp_path: Path) -> None:
    whole, arm = RobotModel.of(load_robot(str(torso_with_arms(tmp_path)))), RobotModel.of(small_arm(tmp_path))
    q = np.array(whole.robot.descriptor.home) + 0.1
    c, s = np.cos(0.6), np.sin(0.6)
    mount = np.array([[c, 0, s, 0], [0, 1, 0, 0.4], [-s, 0, c, 0.15], [0, 0, 0, 1]])
    there = arm.fk_tip(q[:4]) @ mount @ arm.fk_tip(q[4:8])
    assert np.allclose(whole.fk_link("left_rod", q), there, atol=1e-9)


def test_the_distance_of_both_arms_matches_each_alone(tmp_path: Path) -> None:
    both = RobotModel.of(load_robot(str(two_pandas(tmp_path))))
    exact, empty = ExactScene(both, World((), 0.0)), World((), 0.0)
    rng, apart = np.random.default_rng(1), 0
    for _ in range(60):
        q = rng.uniform(both.lower, both.upper)
        each = [
            ExactScene(both.group((name,), q), empty).nearest(q[joints]).distance
            for name, joints in (("left", slice(7)), ("right", slice(7, 14)))
        ]
        whole = exact.nearest(q).distance
        assert (whole > 0.0) == (min(each) > 0.0)
        if whole > 0.0:
            apart += 1
            assert whole == pytest.approx(min(each), abs=1e-5)
    assert apart > 5


def test_distance_along_a_motion_is_the_least_of_its_samples(tmp_path: Path) -> None:
    """Of two arms that pass each other: the search along the motion leaves out nothing that comes near."""
    model = RobotModel.of(load_robot(str(torso_with_arms(tmp_path))))
    exact, rng, near = ExactScene(model, World((), 0.0)), np.random.default_rng(4), 0
    low, high = model.range_about(np.zeros(model.dof))
    for turn in range(150):
        begin = rng.uniform(low, high)
        way = rng.normal(0.0, 0.6, model.dof)
        way[8:] *= turn % 2  # in every other one the right arm stands
        path = np.linspace(begin, np.clip(begin + way, low, high), 160)
        each = [exact.nearest(q) for q in path]
        least = min(each, key=lambda one: one.distance)
        along = exact.nearest(path).distance
        assert (along > 0.0) == (least.distance > 0.0)
        if least.distance > 0.0:
            assert along == pytest.approx(least.distance, abs=2e-5)
        sides = {name.split("_")[0] for name in least.pair or ()}
        near += sides == {"left", "right"}
    assert near > 5


def test_each_arm_keeps_its_gripper(tmp_path: Path) -> None:
    robot = load_robot(str(two_pandas(tmp_path)))
    assert robot.gripper_positions({"left_hand": 0.02})["left_panda_finger_joint2"] == 0.01
    assert robot.gripper_positions({"left_hand": 0.02})["right_panda_finger_joint1"] == 0.04


def test_each_arm_keeps_its_outputs_and_what_is_mounted_on_it(tmp_path: Path) -> None:
    arm = small_arm(tmp_path)
    link = arm.descriptor.tip_link
    with arm.path.open("a", encoding="utf-8") as file:
        file.write(
            f"\noutputs: {{vacuum: {{service: /vacuum, driver_timeout: 3.0}}}}\npayloads: {{{link}: {{mass: 0.5}}}}\n"
        )
    robot = load_robot(str(composed(tmp_path, TORSO))).descriptor
    assert {name: (one.service, one.driver_timeout) for name, one in robot.outputs.items()} == {
        "torso_vacuum": (None, 3.0),
        "left_vacuum": (None, 3.0),
        "right_vacuum": (None, 3.0),
    }
    assert {name: one.mass for name, one in robot.payloads.items()} == {
        f"torso_{link}": 0.5, f"left_{link}": 0.5, f"right_{link}": 0.5,
    }  # fmt: skip


def test_the_check_finds_nothing_wrong_with_a_composition(tmp_path: Path) -> None:
    assert findings(load_robot(str(two_pandas(tmp_path)))) == []


def test_arms_that_stand_in_each_other_are_found(tmp_path: Path) -> None:
    file = composed(tmp_path, TWO_PANDAS.replace("-0.3", "0.25"))
    assert any(fault.startswith("home: ") for fault in findings(load_robot(str(file))))


@pytest.mark.parametrize(
    ("before", "after", "fault"),
    [
        (
            "on: torso, xyz: [0.0, 0.4",
            "on: right, xyz: [0.0, 0.4",
            r"parts.left.on: right is not a part that comes before",
        ),
        ("{robot: small_arm.yaml}", "{robot: giant}", r"parts.torso.robot: unknown robot 'giant'"),
        ("{robot: small_arm.yaml}", "{robot: small_arm.yaml, size: 2}", r"parts.torso.size: Extra inputs"),
        (
            "{robot: small_arm.yaml}",
            "{robot: small_arm.yaml, on: left}",
            r"parts.torso.on: left is not .* it is the first one; leave `on` out",
        ),
    ],
)
def test_a_fault_names_the_line_of_the_composition(tmp_path: Path, before: str, after: str, fault: str) -> None:
    small_arm(tmp_path)
    assert before in TORSO
    with pytest.raises(InvalidRequest, match=rf"composition.yaml:\d+: {fault}"):
        composed(tmp_path, TORSO.replace(before, after, 1))


def test_a_robot_that_is_there_already_is_kept(tmp_path: Path) -> None:
    two_pandas(tmp_path)
    with pytest.raises(InvalidRequest, match="is there already; --overwrite replaces it"):
        two_pandas(tmp_path)


def test_a_composition_that_is_no_robot_replaces_nothing(tmp_path: Path) -> None:
    made = two_pandas(tmp_path)
    before = {file.name: file.read_bytes() for file in made.parent.iterdir()}
    file = tmp_path / "composition.yaml"
    file.write_text(TWO_PANDAS.replace("base_link: table", "base_link: left_panda_link3"), encoding="utf-8")
    with pytest.raises(
        InvalidRequest, match=r"composition.yaml: made of it, pandas.yaml:\d+: .*no group moves left_panda"
    ):
        compose(file, made.parent, overwrite=True)
    assert {file.name: file.read_bytes() for file in made.parent.iterdir()} == before
    assert {*tmp_path.iterdir()} == {file, made.parent}


LED = """
name: cell
parts:
  left:  {robot: panda, executor: left_arm, xyz: [0.0,  0.3, 0.0]}
  right: {robot: panda, executor: right_arm, xyz: [0.0, -0.3, 0.0]}
"""


def test_arms_with_executors_are_led_by_that_of_the_whole(tmp_path: Path) -> None:
    descriptor, panda = load_robot(str(composed(tmp_path, LED))).descriptor, load_robot("panda").descriptor
    assert {group: led.robot for group, led in descriptor.executors.items()} == {
        "left": "left_arm",
        "right": "right_arm",
    }
    own = panda.strategy_params.delay  # type: ignore[union-attr]
    assert all(led.delay == own for led in descriptor.executors.values())
    assert descriptor.command_timing is not None
    assert descriptor.command_timing.delay > own
    assert descriptor.strategy == "executors"
    assert max(descriptor.cspace.acceleration) < 0.95 * max(panda.cspace.acceleration)


@pytest.mark.parametrize(
    ("was", "now", "says"),
    [
        (", executor: right_arm", "", "right has no executor, and left has one"),
        ("right_arm", "left_arm", "a robot is named twice"),
        ("right_arm", "Right Arm", "executor"),
    ],
)
def test_executors_that_cannot_be_meant_are_refused(tmp_path: Path, was: str, now: str, says: str) -> None:
    with pytest.raises(InvalidRequest, match=says):
        composed(tmp_path, LED.replace(was, now))


def test_a_joint_that_no_executor_moves_is_named(tmp_path: Path) -> None:
    path = composed(tmp_path, LED)
    path.write_text(path.read_text().replace("  right:\n    robot: right_arm\n    delay: 0.06\n", ""))
    with pytest.raises(
        InvalidRequest, match="right_panda_joint1 must begin with the name of one of the groups left and _"
    ):
        load_robot(str(path))
    path.write_text(path.read_text().replace("  left:\n    robot: left_arm\n", "  lift:\n    robot: left_arm\n"))
    with pytest.raises(InvalidRequest, match="lift: there is no such group"):
        load_robot(str(path))
