"""The live target of a session: the newest counts, whatever clock its client has, and what cannot be is refused by field."""

from __future__ import annotations

import numpy as np
import pytest

from zarm_contract.messages import JointSpeedTarget, PoseTarget, ServoTarget, TwistTarget
from zarm_servo import targets
from zarm_servo.inbox import Inbox

OFF = 5e8
"""The clock of the client is years off."""
TWIST = TwistTarget(kind="twist", frame="base", linear=(0.1, 0.0, 0.0))


def told(sequence: int, stamp: float, target: PoseTarget | TwistTarget | JointSpeedTarget = TWIST) -> ServoTarget:
    return ServoTarget(goal_id="jog", sequence=sequence, stamp=OFF + stamp, target=target)


def pose(x: float) -> PoseTarget:
    return PoseTarget(kind="pose", frame="base", position=(x, 0.0, 0.5), orientation=(0.0, 0.0, 0.0, 1.0))


@pytest.fixture
def inbox() -> Inbox:
    return Inbox(6)


def test_a_target_is_as_old_as_it_was_under_way_longer_than_the_quickest(inbox: Inbox) -> None:
    inbox.hear(told(1, 0.0), 10.0)
    inbox.hear(told(2, 0.02), 10.07)
    _, age = inbox.newest(10.08)
    assert age == pytest.approx(0.06, abs=1e-3)


def refused(inbox: Inbox) -> str | None:
    assert inbox.refused is not None
    return inbox.refused.field


def test_what_comes_out_of_order_or_far_too_late_or_for_another_robot_is_refused_by_field(inbox: Inbox) -> None:
    inbox.hear(told(2, 0.0), 10.0)
    inbox.hear(told(2, 0.02), 10.02)
    assert refused(inbox) == "sequence"
    inbox.hear(told(3, -0.02), 10.02)
    assert refused(inbox) == "stamp"
    inbox.hear(told(3, 0.02), 10.5)
    assert refused(inbox) == "stamp"
    inbox.hear(told(3, 0.5, JointSpeedTarget(kind="joint_speed", velocity=(0.1, 0.2))), 10.5)
    assert refused(inbox) == "target.velocity"
    target, _ = inbox.newest(10.5)
    assert inbox.sequence == 2
    assert isinstance(target, targets.TwistTarget)


@pytest.mark.parametrize(
    ("target", "field"),
    [
        (pose(1e300), "target.position"),
        (pose(0.5).model_copy(update={"linear": (0.0, 1e6, 0.0)}), "target.linear"),
        (TWIST.model_copy(update={"angular": (0.0, 0.0, -1e300)}), "target.angular"),
        (JointSpeedTarget(kind="joint_speed", velocity=(1e308,) * 6), "target.velocity"),
    ],
)
def test_numbers_that_no_robot_can_mean_are_refused_by_field_and_that_is_told_for_a_second(
    inbox: Inbox, target: PoseTarget | TwistTarget | JointSpeedTarget, field: str
) -> None:
    inbox.hear(told(1, 0.0, target), 10.0)
    assert refused(inbox) == field
    assert inbox.newest(10.0) == (None, None)
    inbox.hear(told(2, 0.02), 10.02)
    assert inbox.newest(10.02)[0] is not None
    assert refused(inbox) == field
    inbox.hear(told(3, 1.1), 11.1)
    assert inbox.refused is None


def test_a_pose_goes_on_as_it_was_seen_to_move_and_one_that_jumps_does_not(inbox: Inbox) -> None:
    def velocity() -> float:
        target, _ = inbox.newest(10.0)
        assert isinstance(target, targets.PoseTarget)
        return float(np.linalg.norm(target.velocity))

    inbox.hear(told(1, 0.0, pose(0.5)), 10.0)
    assert velocity() == 0.0
    inbox.hear(told(2, 0.02, pose(0.502)), 10.02)
    assert velocity() == pytest.approx(0.1)
    inbox.hear(told(3, 0.04, pose(0.8)), 10.04)
    assert velocity() == 0.0
