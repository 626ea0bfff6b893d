"""A URDF of two arms on a torso, with a gripper each, becomes one robot with groups."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from zarm_contract.robot import load_robot
from zarm_geometry.exact import ExactScene
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_robot_import.checking import findings
from zarm_robot_import.importing import Options, import_robot

_LINK = '<link name="{0}"><collision><origin xyz="{1}"/><geometry>{2}</geometry></collision></link>'
_JOINT = (
    '<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/><origin xyz="{4}"/><axis xyz="{5}"/>'
    '<limit lower="{6}" upper="{7}" velocity="2" effort="50"/>{8}</joint>'
)


def arm(side: str, y: float) -> str:
    """Four joints, and two fingers of which one mimics the other."""
    parts, carrier = [], "chest"
    for k in range(4):
        link = f"{side}_link{k}"
        parts.append(_LINK.format(link, "0 0 0.12", '<cylinder radius="0.04" length="0.2"/>'))
        at = f"0 {y} 0.2" if k == 0 else "0 0 0.25"
        axis = "0 0 1" if k % 2 == 0 else "0 1 0"
        parts.append(_JOINT.format(f"{side}_joint{k}", "revolute", carrier, link, at, axis, -2, 2, ""))
        carrier = link
    for finger, sign in (("a", 1), ("b", -1)):
        link = f"{side}_finger_{finger}"
        follows = f'<mimic joint="{side}_grip_a"/>' if finger == "b" else ""
        parts.append(_LINK.format(link, f"0 {0.008 * sign} 0.03", '<box size="0.02 0.016 0.06"/>'))
        parts.append(
            _JOINT.format(
                f"{side}_grip_{finger}", "prismatic", carrier, link, "0 0 0.25", f"0 {sign} 0", 0, 0.04, follows
            )
        )
    return "".join(parts)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dual")
    body = _LINK.format("base", "0 0 0.1", '<box size="0.4 0.4 0.2"/>') + _LINK.format(
        "chest", "0 0 0.2", '<box size="0.15 0.3 0.3"/>'
    )
    waist = _JOINT.format("waist", "revolute", "base", "chest", "0 0 0.2", "0 0 1", -1, 1, "")
    file = folder / "source.urdf"
    file.write_text(f'<robot name="dual">{body}{waist}{arm("left", 0.25)}{arm("right", -0.25)}</robot>')
    descriptor, report = import_robot(file, folder / "made", Options())
    assert [group.name for group in report.chain.groups] == ["left", "right", "torso", "torso+left", "torso+right"]
    assert "`torso+left` moves" in report.markdown()
    return descriptor


def test_each_arm_is_a_group_with_its_gripper(made: Path) -> None:
    robot = load_robot(str(made))
    assert robot.group_joints("left") == tuple(f"left_joint{k}" for k in range(4))
    assert robot.group_joints("torso+right") == ("waist", *(f"right_joint{k}" for k in range(4)))
    assert set(robot.descriptor.grippers) == {"left_gripper", "right_gripper"}
    assert robot.descriptor.grippers["left_gripper"].widths[-1] == pytest.approx(0.08, abs=1e-3)


def test_links_are_where_the_source_has_them(made: Path) -> None:
    model = RobotModel.of(load_robot(str(made)))
    q = np.zeros(model.dof)
    q[0] = 0.5
    x, y = -0.25 * np.sin(0.5), 0.25 * np.cos(0.5)
    assert model.fk_tip(q, "left")[:3, 3] == pytest.approx((x, y, 0.2 + 0.2 + 3 * 0.25))
    assert model.fk_tip(q, "right")[:3, 3] == pytest.approx((-x, -y, 0.2 + 0.2 + 3 * 0.25))


def test_home_is_free_and_arms_are_checked_against_each_other(made: Path) -> None:
    robot = load_robot(str(made))
    model = RobotModel.of(robot)
    assert ExactScene(model, World((), 0.0)).nearest(np.array(robot.descriptor.home)).distance > 0.0
    checked = {frozenset((model.links[i], model.links[j])) for i, j in model.pairs.tolist()}
    assert frozenset(("left_link3", "right_link3")) in checked
    assert frozenset(("left_link1", "left_link0")) not in checked
    assert not [fault for fault in findings(robot) if fault.startswith(("home", "joints", "tip_link"))]
