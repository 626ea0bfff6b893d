"""The live target of a session: the newest counts, whatever clock its client has, and what cannot be is refused by field."""

from __future__ import annotations

import numpy as np
import pytest

from zarm_contract.messages import JointSpeedTarget, PoseTarget, ServoTarget, TwistTarget
from zarm_contract.robot import load_robot
from zarm_servo.tracking import targets
from zarm_servo.tracking.inbox import Inbox

OFF = 5e8
"""The clock of the client is years off."""
TWIST = TwistTarget(kind="twist", frame="base", linear=(0.1, 0.0, 0.0))


def reported(sequence: int, stamp: float, target: PoseTarget | TwistTarget | JointSpeedTarget = TWIST) -> ServoTarget:
    return ServoTarget(goal_id="jog", sequence=sequence, stamp=OFF + stamp, target=target)


def pose(x: float) -> PoseTarget:
    return PoseTarget(kind="pose", frame="base", position=(x, 0.0, 0.5), orientation=(0.0, 0.0, 0.0, 1.0))


@pytest.fixture
def inbox() -> Inbox:
    return Inbox(load_robot("doosan_m1013"))


def test_a_target_s_age_is_its_delay_over_the_quickest(inbox: Inbox) -> None:
    inbox.receive(reported(1, 0.0), 10.0)
    inbox.receive(reported(2, 0.02), 10.07)
    _, age = inbox.newest(10.08)
    assert age == pytest.approx(0.06, abs=1e-3)


def refused(inbox: Inbox) -> str | None:
    assert inbox.refused is not None
    return inbox.refused.field


def test_late_foreign_and_unordered_targets_are_refused(inbox: Inbox) -> None:
    inbox.receive(reported(2, 0.0), 10.0)
    inbox.receive(reported(2, 0.02), 10.02)
    assert refused(inbox) == "sequence"
    inbox.receive(reported(3, -0.02), 10.02)
    assert refused(inbox) == "stamp"
    inbox.receive(reported(3, 0.02), 10.5)
    assert refused(inbox) == "stamp"
    inbox.receive(reported(3, 0.5, JointSpeedTarget(kind="joint_speed", velocity=(0.1, 0.2))), 10.5)
    assert refused(inbox) == "target.velocity"
    target, _ = inbox.newest(10.5)
    assert inbox.sequence == 2
    assert isinstance(target, targets.TwistTarget)


@pytest.mark.parametrize(
    ("sequence", "stamp", "field"),
    [(10**9, 0.06, "sequence"), (4, 1e9, "stamp"), (4, 1.5, "stamp"), (10**9, 1e9, "sequence")],
)
def test_a_target_far_ahead_is_refused_and_the_next_count(
    inbox: Inbox, sequence: int, stamp: float, field: str
) -> None:
    for number in (1, 2, 3):
        inbox.receive(reported(number, 0.02 * number), 10.0 + 0.02 * number)
    inbox.receive(reported(sequence, stamp), 10.08)
    assert refused(inbox) == field
    inbox.receive(reported(4, 0.08), 10.081)
    assert inbox.sequence == 4
    _, age = inbox.newest(10.081)
    assert age == pytest.approx(0.001, abs=1e-3)


@pytest.mark.parametrize("jump", [-20.0, -0.05, 20.0])
def test_a_clock_that_is_set_costs_a_target_or_two(inbox: Inbox, jump: float) -> None:
    inbox.receive(reported(1, 30.0), 10.0)
    inbox.receive(reported(2, 30.02 + jump), 10.02)
    assert refused(inbox) == "stamp"
    inbox.receive(reported(3, 30.04 + jump), 10.04)
    assert inbox.sequence == 3
    inbox.receive(reported(4, 30.06 + jump), 10.09)
    _, age = inbox.newest(10.09)
    assert age == pytest.approx(0.03, abs=1e-3)


def test_numbers_that_begin_anew_cost_a_target(inbox: Inbox) -> None:
    inbox.receive(reported(500, 0.0), 10.0)
    inbox.receive(reported(1, 0.02), 10.02)
    assert refused(inbox) == "sequence"
    inbox.receive(reported(2, 0.04), 10.04)
    assert inbox.sequence == 2


def test_a_first_target_far_ahead_counts_for_a_second(inbox: Inbox) -> None:
    inbox.receive(reported(10**9, 1e9), 10.0)
    for number in range(1, 60):
        inbox.receive(reported(number, 0.02 * number), 10.0 + 0.02 * number)
    assert inbox.sequence == 59


def test_overtaken_targets_are_refused(inbox: Inbox) -> None:
    inbox.receive(reported(9, 0.18), 10.18)
    for number in range(1, 9):
        inbox.receive(reported(number, 0.02 * number), 10.18 + 0.01 * number)
        assert refused(inbox) == "sequence"
    assert inbox.sequence == 9


@pytest.mark.parametrize(
    ("target", "field"),
    [
        (pose(1e300), "target.position"),
        (pose(0.5).model_copy(update={"linear": (0.0, 1e6, 0.0)}), "target.linear"),
        (TWIST.model_copy(update={"angular": (0.0, 0.0, -1e300)}), "target.angular"),
        (JointSpeedTarget(kind="joint_speed", velocity=(1e308,) * 6), "target.velocity"),
    ],
)
def test_impossible_numbers_are_refused_and_reported_for_1_s(
    inbox: Inbox, target: PoseTarget | TwistTarget | JointSpeedTarget, field: str
) -> None:
    inbox.receive(reported(1, 0.0, target), 10.0)
    assert refused(inbox) == field
    assert inbox.newest(10.0) == (None, None)
    inbox.receive(reported(2, 0.02), 10.02)
    assert inbox.newest(10.02)[0] is not None
    assert refused(inbox) == field
    inbox.receive(reported(3, 1.1), 11.1)
    assert inbox.refused is None


def test_a_pose_is_extrapolated_unless_it_jumps(inbox: Inbox) -> None:
    def velocity() -> float:
        target, _ = inbox.newest(10.0)
        assert isinstance(target, targets.PoseTarget)
        return float(np.linalg.norm(target.velocity))

    inbox.receive(reported(1, 0.0, pose(0.5)), 10.0)
    assert velocity() == 0.0
    inbox.receive(reported(2, 0.02, pose(0.502)), 10.02)
    assert velocity() == pytest.approx(0.1)
    inbox.receive(reported(3, 0.04, pose(0.8)), 10.04)
    assert velocity() == 0.0
    inbox.receive(reported(4, -9.0, pose(0.801)), 10.06)
    inbox.receive(reported(5, -8.98, pose(0.802)), 10.08)
    assert velocity() == 0.0
