"""What every strategy that moves a robot promises, whatever driver is behind it."""

from __future__ import annotations

import sys
from itertools import pairwise
from pathlib import Path as Folder

import numpy as np
import pytest

from support.arrivals import arrival
from support.executor.driven import FAR, LIMIT
from support.executor.driver_bench import JOINTS, MOVING, Case, DriverBench, distance_from
from support.executor.waves import target
from support.tiers import sampled
from support.trajectories import HOME, rest_to_rest, trapezoid
from zarm_contract.errors import Unavailable
from zarm_contract.messages import Authority, Trajectory
from zarm_contract.strategies import DRIVER_STRATEGIES
from zarm_executor.machine import STALL_LIMIT
from zarm_executor.strategies.joint_speed import ARRIVED, JointSpeed
from zarm_trajectory.trajectory import TimedTrajectory

at_every_rate = pytest.mark.parametrize("rate", sampled(100.0, 130.0, 250.0, 500.0))
"""Of the control loop, Hz; at 130 no period of chunks or of points is one of ticks."""

at_every_phase = pytest.mark.parametrize(
    ("rate", "phase"),
    sampled((100.0, 0.0), (100.0, 0.009), (130.0, 0.003), (250.0, 0.003), (250.0, 0.009), (500.0, 0.003)),
)
"""Where (s) between two ticks of the control loop (Hz) those of the driver are."""


@pytest.fixture
def rate() -> float:
    return 100.0


@pytest.fixture
def phase() -> float:
    return 0.003


REPEATED = {MOVING[2], MOVING[4], MOVING[5]}
"""Cases that differ little from others, and that `tests/process/executor` moves too."""


@pytest.fixture(
    params=[pytest.param(case, marks=pytest.mark.slow if case in REPEATED else ()) for case in MOVING], ids=str
)
def bench(request: pytest.FixtureRequest, rate: float, phase: float, tmp_path: Folder) -> DriverBench:
    return DriverBench(request.param, tmp_path, rate, phase)


@at_every_rate
def test_it_reaches_the_goal_inside_the_limits(bench: DriverBench) -> None:
    path = bench.execute()
    bench.until("idle")
    assert bench.statuses() == ["accepted", "running", "succeeded"]
    assert bench.last().progress == 1.0
    assert bench.last().elapsed < path.duration + 1.0
    assert bench.rests()
    np.testing.assert_allclose(bench.positions[-1], FAR, atol=0.005)
    assert bench.commanded_acceleration() <= LIMIT * 1.001


@at_every_rate
@pytest.mark.parametrize("phase", sampled(0.009, 0.0))
@pytest.mark.parametrize("after", sampled(0.7, 0.05, 1.5, 2.3))
def test_a_stop_decelerates_within_limits_on_the_path(bench: DriverBench, after: float) -> None:
    path = bench.execute()
    bench.run(after)
    bench.machine.cancel(None, "enough", arrival())
    bench.until("idle", patience=4.0)
    assert bench.statuses()[-2:] == ["stopping", "cancelled"]
    assert bench.rests()
    if bench.case.params != (("stop", "empty"),):  # then the driver brakes by itself, each joint for itself
        assert distance_from(path, bench.positions[-1]) < 0.002
        assert bench.commanded_acceleration() <= LIMIT * 1.001


@pytest.mark.lengthy
@pytest.mark.parametrize("after", sampled(0.7, 0.05, 1.5))
def test_a_paused_goal_is_held_and_goes_on_to_its_end(bench: DriverBench, after: float) -> None:
    bench.execute()
    bench.run(after)
    bench.machine.pause(arrival())
    bench.until("paused", patience=4.0)
    assert bench.rests()
    held = bench.positions[-1]
    bench.run(5.0)
    np.testing.assert_allclose(bench.positions[-1], held, atol=1e-6)
    bench.machine.resume(arrival())
    bench.until("idle")
    assert bench.statuses() == ["accepted", "running", "paused", "running", "succeeded"]
    assert bench.rests()
    np.testing.assert_allclose(bench.positions[-1], FAR, atol=0.005)


@pytest.mark.lengthy
@pytest.mark.parametrize("ticks", sampled(1, 0, *range(2, 8), 40))
@pytest.mark.parametrize("command", ["pause", "slower", "cancel"])
def test_a_command_just_after_the_start_is_carried_out(bench: DriverBench, ticks: int, command: str) -> None:
    bench.execute(HOME + (FAR - HOME) / 4, timed=trapezoid)
    bench.run(ticks * bench.period)
    if command == "pause":
        bench.machine.pause(arrival())
        bench.until("paused", patience=4.0)
        bench.machine.resume(arrival())
    elif command == "slower":
        bench.machine.set_speed(0.3)
        bench.run(0.2)
        bench.machine.set_speed(1.0)
    else:
        bench.machine.cancel(None, "enough", arrival())
    bench.until("idle", patience=4.0)
    assert bench.last().status == ("cancelled" if command == "cancel" else "succeeded")
    assert bench.rests()
    if bench.case.params != (("stop", "empty"),):
        assert bench.commanded_acceleration() <= LIMIT * 1.01


@pytest.mark.lengthy
@at_every_phase
@pytest.mark.parametrize("changes", sampled([0.6, 0.05, 1.0], [0.3], [0.5, 1.0], [0.9, 0.8, 0.7, 0.6]), ids=str)
def test_speed_changes_within_limits_and_reaches_the_goal(bench: DriverBench, changes: list[float]) -> None:
    path = bench.execute()
    bench.run(0.6)
    for scale in changes:
        bench.machine.set_speed(scale)
        bench.run(0.33)
    bench.until("idle", patience=60.0)
    assert bench.statuses() == ["accepted", "running", "succeeded"]
    assert bench.last().elapsed > path.duration + 0.1
    assert bench.rests()
    np.testing.assert_allclose(bench.positions[-1], FAR, atol=0.005)
    assert bench.commanded_acceleration() <= LIMIT * 1.001


@pytest.mark.lengthy
@pytest.mark.parametrize("scale", sampled(0.4, 0.05))
def test_at_lower_speed_a_goal_is_held_and_not_overdue(bench: DriverBench, scale: float) -> None:
    bench.machine.set_speed(scale)
    path = bench.execute()
    bench.run(0.48 / scale)
    bench.machine.pause(arrival())
    bench.until("paused", patience=2.0)
    bench.run(1.0)
    bench.machine.resume(arrival())
    bench.until("idle", patience=100.0)
    assert bench.statuses() == ["accepted", "running", "paused", "running", "succeeded"]
    assert bench.last().elapsed > path.duration / scale
    np.testing.assert_allclose(bench.positions[-1], FAR, atol=0.01)
    if bench.case.params != (("stop", "empty"),):
        assert bench.commanded_acceleration() <= LIMIT * 1.001


@pytest.mark.lengthy
def test_a_goal_at_the_slowest_speed_is_cancelled_at_once(bench: DriverBench) -> None:
    bench.machine.set_speed(0.05)
    bench.execute()
    bench.run(8.0)
    bench.machine.cancel(None, "enough", arrival())
    bench.until("idle", patience=1.5)
    assert bench.last().status == "cancelled"
    assert bench.rests()


@pytest.mark.lengthy
@at_every_phase
@pytest.mark.parametrize("share", sampled(0.5, 0.3, 0.8))
def test_it_rests_before_its_authority_ends_and_goes_on_later(bench: DriverBench, share: float) -> None:
    path = bench.execute()
    until = share * path.duration
    for sequence in range(1, round((path.duration + 2.0) / 0.1)):
        bench.machine.receive(Authority(servo="servo", sequence=sequence, goal_id="goal", until=until), bench.now)
        bench.run(0.1)
    assert bench.machine.state().mode == "running"
    assert bench.last().hold is not None
    way = path.sample(np.linspace(0.0, until, 2000))[0]
    itself = ("stop", "empty") in bench.case.params  # a driver that brakes by itself leaves the path
    assert min(float(np.abs(bench.positions[-1] - q).max()) for q in way) < (0.05 if itself else 0.005)
    assert np.all(np.abs(bench.positions[-1] - path.at(until)[0]) < 0.25)
    assert bench.rests()
    bench.machine.receive(Authority(servo="servo", sequence=1000, goal_id="goal"), bench.now)
    bench.until("idle")
    assert bench.last().status == "succeeded"
    np.testing.assert_allclose(bench.positions[-1], FAR, atol=0.01)
    assert itself or bench.acceleration() <= LIMIT * 1.1


@pytest.mark.lengthy
def test_a_goal_that_cannot_stop_before_its_end_is_over(bench: DriverBench) -> None:
    path = bench.execute(timed=trapezoid)  # which brakes to its end at the limits
    bench.run(path.duration - 0.2)
    bench.machine.receive(Authority(servo="servo", sequence=1, goal_id="goal", until=0.5 * path.duration), bench.now)
    bench.until("idle", patience=4.0)
    assert bench.last().status == "succeeded"
    holds = [state.hold is not None for state in bench.machine.changes]
    assert sum(after and not before for before, after in pairwise(holds)) == 1


@pytest.mark.lengthy
@at_every_phase
def test_it_goes_on_while_it_still_brakes_for_a_pause(bench: DriverBench) -> None:
    bench.execute()
    bench.run(1.0)
    bench.machine.pause(arrival())
    bench.run(0.2)
    bench.machine.resume(arrival())
    bench.until("idle")
    assert bench.statuses()[-1] == "succeeded"
    if bench.case.params != (("stop", "empty"),):
        assert bench.commanded_acceleration() <= LIMIT * 1.001


@pytest.mark.lengthy
def test_a_goal_cancelled_on_resuming_rests_without_a_fault(bench: DriverBench) -> None:
    bench.execute()
    bench.run(0.7)
    bench.machine.pause(arrival())
    bench.until("paused", patience=4.0)
    bench.run(3.0)
    bench.machine.resume(arrival())
    bench.run(0.05)
    bench.machine.cancel(None, "enough", arrival())
    bench.until("idle", patience=4.0)
    assert bench.last().status == "cancelled"
    assert bench.rests()


def test_a_goal_cancelled_before_its_first_tick_does_not_move(bench: DriverBench) -> None:
    bench.execute()
    bench.machine.cancel(None, "never mind", arrival())
    bench.until("idle")
    assert bench.statuses() == ["accepted", "stopping", "cancelled"]
    assert bench.rests()
    np.testing.assert_allclose(bench.positions[-1], HOME, atol=1e-6)


@pytest.mark.lengthy
def test_one_motion_follows_another(bench: DriverBench) -> None:
    for goal, start in ((FAR, HOME), (HOME, FAR), (FAR, HOME)):
        bench.execute(goal, start)
        bench.until("idle")
        assert bench.last().status == "succeeded"
        assert bench.rests()
        np.testing.assert_allclose(bench.positions[-1], goal, atol=0.005)


TELLS = Case("joint_trajectory")


@pytest.mark.parametrize("lost_from", [0.97, 0.999])
def test_at_the_goal_it_succeeds_without_driver_progress(tmp_path: Folder, lost_from: float) -> None:
    bench = DriverBench(TELLS, tmp_path)
    bench.progress.lost_from = lost_from
    bench.execute()
    bench.until("idle")
    assert bench.last().status == "succeeded"
    assert not bench.commands[-1][1].time, "what the driver may have left is taken from it"
    np.testing.assert_allclose(bench.positions[-1], FAR, atol=0.005)


def test_where_its_path_crosses_itself_the_goal_is_not_reached(tmp_path: Folder) -> None:
    bench = DriverBench(TELLS, tmp_path)
    there, back = rest_to_rest(FAR), rest_to_rest(HOME, FAR)
    there_and_back = Trajectory(
        joint_names=there.joint_names,
        time=there.time + tuple(there.duration + time for time in back.time[1:]),
        position=there.position + back.position[1:],
        velocity=there.velocity + back.velocity[1:],
        acceleration=there.acceleration + back.acceleration[1:],
    )
    bench.execute(HOME, timed=lambda *_: there_and_back)
    bench.run(0.2)
    bench.stalled = True
    bench.until("fault")
    assert bench.last().problem is not None
    assert bench.last().problem.code == "driver_stalled"


@pytest.mark.lengthy
def test_a_switch_in_motion_brings_the_robot_to_rest_first(bench: DriverBench) -> None:
    bench.execute()
    bench.run(1.0)
    bench.switch("ghost")
    assert bench.last().status == "cancelled"
    assert bench.machine.state().strategy == "ghost"
    where = bench.arm.position
    with pytest.raises(Unavailable, match="executor/strategy"):
        bench.machine.admit()
    bench.run(1.0)
    np.testing.assert_allclose(bench.arm.position, where, atol=0.005)
    bench.switch(bench.case.strategy)
    bench.tick()
    bench.execute(FAR, bench.positions[-1])
    bench.until("idle")
    assert bench.last().status == "succeeded"


@pytest.mark.lengthy
def test_a_driver_strategy_that_cannot_open_keeps_the_old_one(tmp_path: Folder) -> None:
    for number, case in enumerate(MOVING[1:]):
        bench = DriverBench(case, tmp_path / str(number))
        bench.switch("emulator")
        bench.joint_states.newest = None
        bench.silent = True
        strategy = bench.registry.find(case.strategy)
        strategy.link._measured = None  # type: ignore[attr-defined]  # as in a process that has just started
        with pytest.raises(Unavailable, match=r"start the robot's driver; emulator is active again"):
            bench.switch(case.strategy)
        assert bench.machine.state().strategy == "emulator"
        bench.execute()
        bench.until("idle")
        assert bench.last().status == "succeeded"


@at_every_rate
@pytest.mark.parametrize("after", sampled(0.7, 0.02, 1.5, 2.38))
def test_a_loop_away_in_motion_ends_in_fault_at_rest(bench: DriverBench, after: float) -> None:
    bench.execute()
    bench.run(after)
    bench.freeze(STALL_LIMIT + 0.5)
    bench.until("fault", patience=4.0)
    assert bench.last().status == "aborted"
    assert bench.rests()


@pytest.mark.lengthy
@pytest.mark.parametrize("case", MOVING[1:], ids=str)
def test_a_robot_that_stands_is_not_moved_in_order_to_brake(case: Case, tmp_path: Folder) -> None:
    bench = DriverBench(case, tmp_path)
    bench.execute()
    bench.run(0.7)
    bench.stalled = True
    bench.run(0.9)
    bench.machine.cancel(None, "enough", arrival())
    bench.run(0.1)
    stood = bench.arm.position
    bench.stalled = False
    bench.run(3.0)
    np.testing.assert_allclose(bench.arm.position, stood, atol=0.02)  # positions hold it on the path, not beside it


@pytest.mark.lengthy
@pytest.mark.parametrize("case", MOVING[1:], ids=str)
def test_a_robot_that_does_not_stop_is_stopped_until_it_does(case: Case, tmp_path: Folder) -> None:
    bench = DriverBench(case, tmp_path)
    bench.execute()
    bench.run(1.0)
    velocity = bench.arm.velocity.copy()
    step = bench.arm.step

    def runaway(*, stalled: bool) -> None:
        step(stalled=stalled)
        bench.arm.velocity = velocity
        bench.arm.position = bench.positions[-1] + velocity * 0.01

    bench.arm.step = runaway  # type: ignore[method-assign]
    bench.machine.cancel(None, "enough", arrival())
    bench.until("fault", patience=4.0)
    assert bench.last().status == "aborted"
    assert bench.last().problem is not None
    assert "emergency stop" in bench.last().problem.message
    sent = len(bench.commands)
    bench.run(1.0)
    reported = [command for _, command in bench.commands[sent:]]
    assert 8 <= len(reported) <= 12
    assert not any(command.time for command in reported)
    bench.arm.step = step  # type: ignore[method-assign]
    bench.run(3.0)
    sent = len(bench.commands)
    assert bench.rests()
    assert len(bench.commands) == sent


# --- streams ---

STEERABLE = MOVING[:3]


@pytest.mark.lengthy
@pytest.mark.parametrize("case", STEERABLE, ids=str)
def test_a_streamed_target_is_followed_within_limits(case: Case, tmp_path: Folder) -> None:
    bench = DriverBench(case, tmp_path)
    time = bench.stream(3.0)
    lag = 0.0 if case.strategy == "emulator" else 0.06
    expected = target(time - lag)[0]
    assert bench.positions[-1][0] - HOME[0] == pytest.approx(expected, abs=0.002 if lag == 0.0 else 0.03)
    assert bench.machine.state().mode == "running"
    sent = len(bench.commands)
    bench.run(0.17)  # the deadline, and the next point of the driver
    assert bench.machine.state().mode == "stopping"
    if case.strategy != "emulator":
        _, command = next(item for item in reversed(bench.commands[sent:]) if item[1].time)
        first, second = np.abs(np.diff(command.position, axis=0)).max(axis=1)[[0, 1]]
        assert second < first
    bench.until("idle", patience=1.5)
    assert bench.last().problem is not None
    assert bench.last().problem.code == "timeout"
    assert bench.rests()
    assert bench.commanded_acceleration() <= LIMIT * 1.001
    bench.execute(HOME, bench.positions[-1])
    bench.until("idle")
    assert bench.last().status == "succeeded"


@pytest.mark.lengthy
@pytest.mark.parametrize("case", STEERABLE, ids=str)
def test_a_stream_is_held_slowed_and_switched_like_any_goal(case: Case, tmp_path: Folder) -> None:
    bench = DriverBench(case, tmp_path)
    bench.stream(1.0)
    bench.machine.set_speed(0.3)
    bench.run(0.03)
    bench.machine.pause(arrival())
    bench.until("paused", patience=2.0)
    bench.run(1.0)
    assert bench.machine.state().mode == "paused"
    bench.machine.resume(arrival())
    bench.run(0.05)
    bench.switch("ghost")
    assert bench.last().status == "cancelled"
    assert bench.machine.state().strategy == "ghost"


@pytest.mark.parametrize("case", MOVING[3:], ids=str)
def test_a_strategy_of_whole_motions_refuses_a_stream(case: Case, tmp_path: Folder) -> None:
    bench = DriverBench(case, tmp_path)
    with pytest.raises(Unavailable, match="switch to another strategy"):
        bench.stream(0.05)
    assert bench.machine.state().mode == "idle"


def test_a_strategy_the_driver_cannot_play_is_unavailable(tmp_path: Folder) -> None:
    bench = DriverBench(Case("emulator", params=(("strategies", ("joint_speed", "joint_trajectory")),)), tmp_path)
    infos = {info.name: info for info in bench.registry.describe()}
    assert infos["joint_speed"].available
    assert not infos["joint_pose"].available
    assert "strategy_params.strategies" in (infos["joint_pose"].reason or "")
    with pytest.raises(Unavailable, match="its driver cannot play it"):
        bench.registry.find("joint_pose")


class Slowly(JointSpeed):
    """Moves at half the speed that was asked for."""

    name = "slowly"

    def start(self, path: TimedTrajectory, speed: float) -> None:
        super().start(path, speed / 2)


def around_a_corner(goal: np.ndarray, start: np.ndarray) -> Trajectory:
    """Some joints move first, and the others before these have come to rest."""
    first = np.array([1.0, 0.0, 1.0, 0.0, 1.0, 0.0]) * (goal - start)
    legs = [TimedTrajectory.of(rest_to_rest(leg, np.zeros(6)), JOINTS) for leg in (first, goal - start - first)]
    overlap = 0.5 * legs[0].duration
    time = np.linspace(0.0, overlap + legs[1].duration, 400)
    begins = (0.0, overlap)
    states = []
    for leg, begin in zip(legs, begins, strict=True):
        state = leg.sample(np.clip(time - begin, 0.0, leg.duration))
        state[1:, (time < begin) | (time > begin + leg.duration)] = 0.0
        states.append(state)
    position, velocity, acceleration = states[0] + states[1]
    return TimedTrajectory(time, position + start, velocity, acceleration).message(JOINTS)


@pytest.mark.parametrize("delay", [0.0, 0.02, 0.12])
def test_a_driver_with_another_delay_stays_on_its_path(delay: float, tmp_path: Folder) -> None:
    """Corrected towards where it should have been at a wrong time, a robot would cut corners by 15 mrad."""
    bench = DriverBench(Case("joint_speed", params=(("delay", delay),)), tmp_path)
    path = bench.execute(timed=around_a_corner)
    bench.until("idle")
    assert bench.last().status == "succeeded"
    assert max(distance_from(path, position) for position in bench.positions) < 0.004
    np.testing.assert_allclose(bench.positions[-1], path.end, atol=0.005)


def test_a_robot_short_of_the_end_is_led_to_it(tmp_path: Folder) -> None:
    """Although it is where it was commanded shortly before."""
    bench = DriverBench(Case("joint_speed", params=(("delay", 0.2),)), tmp_path)
    path = bench.execute()
    bench.run(path.duration + 0.1)
    way = path.end - path.start
    bench.arm.displace(-0.004 * way / np.abs(way).max())
    bench.until("idle")
    np.testing.assert_allclose(bench.positions[-1], path.end, atol=ARRIVED)


def test_a_new_strategy_is_a_module_and_a_line_in_the_list(tmp_path: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "zarm_executor.strategies.slowly", sys.modules[__name__])
    monkeypatch.setitem(DRIVER_STRATEGIES, "slowly", "chunks")  # type: ignore[arg-type]
    bench = DriverBench(Case("slowly", params=(("strategies", ("slowly",)),)), tmp_path)
    assert [info.name for info in bench.registry.describe() if info.available] == ["emulator", "ghost", "slowly"]
    path = bench.execute()
    bench.until("idle")
    assert bench.last().status == "succeeded"
    assert bench.last().elapsed > 1.9 * path.duration


# -- continuous joints --


@pytest.mark.parametrize("case", MOVING[1:], ids=str)
def test_joint_states_that_wrap_are_followed_both_ways(case: Case, tmp_path: Folder) -> None:
    bench = DriverBench(case, tmp_path, wraps=True)
    beyond = np.array([*HOME[:5], 4.0])
    bench.execute(beyond)
    bench.until("idle")
    assert bench.last().status == "succeeded"
    assert bench.arm.position[5] == pytest.approx(4.0, abs=0.01)
    assert bench.positions[-1][5] == pytest.approx(4.0, abs=0.01)
    assert np.abs(np.diff(np.array(bench.positions)[:, 5])).max() < 0.1
    bench.execute(HOME, beyond)
    bench.until("idle")
    assert bench.last().status == "succeeded"
    assert bench.positions[-1][5] == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("case", MOVING[1:], ids=str)
def test_an_executor_started_beyond_the_wrap_moves_on(case: Case, tmp_path: Folder) -> None:
    bench = DriverBench(case, tmp_path, wraps=True, start=np.array([*HOME[:5], 15.0]))
    bench.run(0.1)
    here = bench.positions[-1]
    bench.execute(here + 1.5 * np.eye(6)[5], here)
    bench.until("idle")
    assert bench.last().status == "succeeded"
    assert bench.arm.position[5] == pytest.approx(16.5, abs=0.01)
