"""How the goal of a gripper ends: where it shall be, on an object, or with the reason why not."""

from __future__ import annotations

import pytest

from zarm_contract.errors import Busy, InvalidRequest, Unavailable
from zarm_contract.gripper import Gripper
from zarm_contract.messages import DriverGripperState, GripperRequest, GripperState
from zarm_executor.gripper_control import GripperControl
from zarm_executor.gripper_links import EmulatedGripper, GripperLink

HAND = Gripper(joint="finger", positions=(0.0, 0.04), widths=(0.0, 0.08), pads=("pad",), speed=0.1, force=70.0)
TICK = 0.02


class Fingers(GripperLink):
    """Fingers that the test moves; `commands` are (position, speed, force)."""

    def __init__(self) -> None:
        self.commands: list[tuple[float, float, float]] = []
        self.at: tuple[float, float] | None = None
        self.said: DriverGripperState | None = None

    def command(self, position: float, speed: float, force: float) -> None:
        self.commands.append((position, speed, force))

    def tick(self, dt: float) -> None:
        pass

    def measured(self) -> tuple[float, float] | None:
        return self.at

    def report(self) -> DriverGripperState | None:
        return self.said


class Hand:
    """A gripper with a clock that the test advances."""

    def __init__(self, link: GripperLink, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 100.0
        monkeypatch.setattr("zarm_executor.gripper_control.clock.monotonic", lambda: self.now)
        self.control = GripperControl("hand", HAND, link)

    def start(self, **request: object) -> None:
        self.control.start(GripperRequest.model_validate(request), "grip-1")

    def run(self, seconds: float) -> GripperState:
        for _ in range(round(seconds / TICK)):
            self.now += TICK
            self.control.tick(self.now, TICK)
        return self.control.state()


def test_an_emulated_gripper_takes_the_time_of_its_speed(monkeypatch: pytest.MonkeyPatch) -> None:
    hand = Hand(EmulatedGripper(0.04), monkeypatch)
    hand.start(width=0.02, speed=0.05)
    assert hand.run(0.6).width == pytest.approx(0.05)
    last = hand.run(0.62)
    assert (last.status, last.goal_id) == ("reached", "grip-1")
    assert last.width == pytest.approx(0.02, abs=HAND.tolerance)


def test_the_driver_gets_joint_position_speed_and_force(monkeypatch: pytest.MonkeyPatch) -> None:
    fingers = Fingers()
    hand = Hand(fingers, monkeypatch)
    hand.start(width=0.04, speed=0.05, force=20.0)
    assert fingers.commands == [pytest.approx((0.02, 0.025, 20.0))]


def test_fingers_that_stop_on_their_way_have_stalled(monkeypatch: pytest.MonkeyPatch) -> None:
    fingers = Fingers()
    hand = Hand(fingers, monkeypatch)
    fingers.at = 0.04, hand.now
    hand.start(width=0.0)
    for step in range(10):
        fingers.at = 0.04 - 0.002 * step, hand.now
        assert hand.run(TICK).status == "moving"
    for _ in range(10):
        fingers.at = 0.022, hand.now
        hand.run(2 * TICK)
    stalled = hand.control.state()
    assert (stalled.status, stalled.problem) == ("stalled", None)
    assert stalled.width == pytest.approx(0.044)
    assert len(fingers.commands) == 1, "it goes on holding"


def test_a_driver_that_reports_nothing_ends_the_goal(monkeypatch: pytest.MonkeyPatch) -> None:
    hand = Hand(Fingers(), monkeypatch)
    hand.start(width=0.0)
    assert hand.run(HAND.driver_timeout - 0.1).status == "moving"
    aborted = hand.run(0.2)
    assert aborted.status == "aborted"
    assert aborted.problem is not None
    assert "has reported nothing for 2 s" in aborted.problem.message


def test_fingers_that_never_move_hold_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    fingers = Fingers()
    hand = Hand(fingers, monkeypatch)
    hand.start(width=0.0)
    for _ in range(110):
        fingers.at = 0.04, hand.now
        hand.run(TICK)
    aborted = hand.control.state()
    assert aborted.status == "aborted"
    assert aborted.problem is not None
    assert "have not moved for 2 s" in aborted.problem.message


@pytest.mark.parametrize(
    ("said", "status"),
    [
        ({"reached": True}, "reached"),
        ({"stalled": True}, "stalled"),
        ({"problem": "the gripper has no power"}, "aborted"),
    ],
)
def test_what_the_driver_reports_ends_the_goal(
    monkeypatch: pytest.MonkeyPatch, said: dict[str, object], status: str
) -> None:
    fingers = Fingers()
    hand = Hand(fingers, monkeypatch)
    hand.start(width=0.0)
    fingers.said = DriverGripperState.model_validate({"gripper": "hand", "sequence": 1, **said})
    last = hand.run(TICK)
    assert last.status == status
    if "problem" in said:
        assert last.problem is not None
        assert "the gripper has no power" in last.problem.message


def test_a_cancel_holds_the_fingers_where_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    fingers = Fingers()
    hand = Hand(fingers, monkeypatch)
    hand.start(width=0.0)
    fingers.at = 0.03, hand.now
    hand.run(TICK)
    hand.control.cancel("the goal was cancelled by a client")
    assert fingers.commands[-1][0] == 0.03
    assert hand.control.state().status == "cancelled"


def test_a_second_client_is_refused_unless_it_preempts(monkeypatch: pytest.MonkeyPatch) -> None:
    hand = Hand(EmulatedGripper(0.04), monkeypatch)
    hand.start(width=0.0)
    with pytest.raises(Busy, match="hand moves for grip-1"):
        hand.control.start(GripperRequest(width=0.08), "grip-2")
    hand.control.start(GripperRequest(width=0.08, preempt=True), "grip-2")
    assert hand.run(TICK).goal_id == "grip-2"


@pytest.mark.parametrize(
    ("request_", "field"),
    [
        ({"width": 0.09}, "width"),
        ({"position": -0.01}, "position"),
        ({}, "width"),
        ({"width": 0.0, "force": 71.0}, "force"),
        ({"width": 0.0, "speed": 0.2}, "speed"),
    ],
)
def test_what_the_fingers_cannot_do_is_refused(
    monkeypatch: pytest.MonkeyPatch, request_: dict[str, object], field: str
) -> None:
    hand = Hand(EmulatedGripper(0.04), monkeypatch)
    with pytest.raises(InvalidRequest) as refused:
        hand.start(**request_)
    assert refused.value.problem.field == field
    assert hand.control.state().status == "idle"


def test_without_anything_that_moves_it_it_is_unavailable(monkeypatch: pytest.MonkeyPatch) -> None:
    hand = Hand(EmulatedGripper(0.04), monkeypatch)
    hand.control.switch(None)
    with pytest.raises(Unavailable):
        hand.start(width=0.0)
