"""Collision geometry has the fingers where they are measured."""

from __future__ import annotations

import numpy as np
import pytest

from support.planner.second_opinion import Collisions
from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import GripperOpening, GripperState, GripperStatus, Sphere
from zarm_contract.robot import load_robot
from zarm_geometry.exact import ExactScene
from zarm_geometry.gripper_openings import GripperOpenings
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World

PANDA = load_robot("panda")
MODEL = RobotModel.of(PANDA)


def finger(model: RobotModel, name: str) -> float:
    """How far a finger is from the middle of the hand (m)."""
    poses = dict(zip(model.links, model.link_transforms(PANDA.descriptor.home), strict=True))
    return float(np.linalg.norm((np.linalg.inv(poses["panda_hand"]) @ poses[name])[:2, 3]))


@pytest.mark.parametrize("width", [0.0, 0.013, 0.08])
def test_both_fingers_stand_half_the_width_from_the_middle(width: float) -> None:
    model = MODEL.with_attached((), (), (("hand", width),))
    for name in ("panda_leftfinger", "panda_rightfinger"):
        assert finger(model, name) == pytest.approx(width / 2)


def test_collisions_are_those_of_another_library_at_any_width() -> None:
    rng, found = np.random.default_rng(4), []
    poses = dict(zip(MODEL.links, MODEL.link_transforms(PANDA.descriptor.home), strict=True))
    for _ in range(200):
        width = round(float(rng.uniform(0.0, 0.08)), 3)
        place = poses["panda_hand"] @ [0.0, *rng.uniform((-0.06, 0.08), (0.06, 0.12)), 1.0]
        ball = Sphere(kind="sphere", name="ball", position=tuple(place[:3].tolist()), radius=0.004)
        model = MODEL.with_attached((), (), (("hand", width),))
        ours = ExactScene(model, World((ball,), 0.0)).nearest(np.array(PANDA.descriptor.home)).distance <= 0.0
        assert ours == Collisions(PANDA, [ball], widths={"hand": width}).at(PANDA.descriptor.home)
        found.append(ours)
    assert 20 < sum(found) < 180


def test_openings_are_open_then_as_measured_to_the_millimetre() -> None:
    changes: list[bool] = []
    openings = GripperOpenings(PANDA.descriptor, lambda: changes.append(True))
    assert openings.present() == (("hand", 0.08),)
    for width in (0.0304, 0.0301):
        openings.receive("", GripperState(gripper="hand", status="reached", widths=(0.0, 0.08), width=width))
        assert openings.present() == (("hand", 0.03),)
    openings.receive("", GripperState(gripper="hand", status="idle", widths=(0.0, 0.08)))
    assert openings.present() == (("hand", 0.03),)
    assert len(changes) == 1
    assert openings.chosen((GripperOpening(gripper="hand", width=0.05),)) == (("hand", 0.05),)


def moving(width: float, status: GripperStatus = "moving") -> GripperState:
    return GripperState(gripper="hand", status=status, widths=(0.0, 0.08), width=width, target=0.02, goal_id="grip-1")


def test_a_gripper_that_moves_counts_where_its_goal_leads() -> None:
    openings = GripperOpenings(PANDA.descriptor)
    openings.receive("", moving(0.06))
    assert openings.present() == (("hand", 0.06),)
    assert openings.chosen(()) == (("hand", 0.02),)
    assert openings.chosen((GripperOpening(gripper="hand", width=0.05),)) == (("hand", 0.05),)


def test_whether_it_still_moves_the_executor_is_asked() -> None:
    openings = GripperOpenings(PANDA.descriptor, ask=lambda _: moving(0.03, "stalled"))
    openings.receive("", moving(0.06))
    assert openings.chosen(()) == openings.present() == (("hand", 0.03),)


@pytest.mark.parametrize(
    ("opening", "field"),
    [
        (GripperOpening(gripper="claw", width=0.05), "openings.0.gripper"),
        (GripperOpening(gripper="hand", width=0.09), "openings.0.width"),
    ],
)
def test_openings_that_no_gripper_has_are_refused(opening: GripperOpening, field: str) -> None:
    with pytest.raises(InvalidRequest) as refused:
        GripperOpenings(PANDA.descriptor).chosen((opening,))
    assert refused.value.problem.field == field
