"""A switch of strategy in every state of the robot: what becomes of the goal, and which strategy is active then."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import pytest

from support.arrivals import arrival
from support.executor.bench import Arm, Bench
from support.executor.waves import chunk
from support.harness import PATIENCE
from zarm_contract.errors import Busy, Cancelled, Unavailable


class Other(Arm):
    name = "other"


def switch(bench: Bench, other: Arm) -> None:
    """Switch while time passes; raises what the switch raises."""
    with ThreadPoolExecutor(1) as pool:
        switched = pool.submit(bench.machine.switch, other, PATIENCE, arrival())
        while not switched.done():
            bench.tick()
        switched.result()


def prepare(state: str) -> Bench:
    """A bench in this state."""
    bench = Bench()
    if state == "stream":
        bench.stream(chunk(0.0), deadline=1.0)
        bench.run(0.3)
    elif state != "idle":
        bench.execute()
        bench.run(0.5)
    if state == "paused":
        bench.machine.pause(arrival())
        bench.until("paused")
    elif state == "pausing":
        bench.machine.pause(arrival())
    elif state == "stopping":
        bench.machine.cancel(None, "enough", arrival())
    elif state == "fault":
        bench.arm.disturb = lambda _: None
        bench.until("fault")
    return bench


STATES = ["idle", "running", "pausing", "paused", "stopping", "stream", "fault"]


@pytest.mark.parametrize("state", STATES)
def test_in_every_state_a_switch_rests_the_robot_first(state: str) -> None:
    bench, other = prepare(state), Other()
    switch(bench, other)
    assert bench.machine.state().strategy == "other"
    assert (bench.arm.is_open, other.is_open) == (False, True)
    if state != "idle":
        assert bench.arm.follower.at_rest
        assert bench.greatest_acceleration() <= 1.015
    assert bench.machine.state().mode == ("fault" if state == "fault" else "idle")
    if state not in ("idle", "fault"):
        assert bench.last().status == "cancelled"
    if state == "fault":
        with pytest.raises(Unavailable, match="fault"):
            bench.machine.admit()
        bench.machine.reset(arrival())
    bench.machine.admit()


@pytest.mark.parametrize("state", STATES)
def test_in_every_state_a_failed_switch_keeps_the_old_strategy(state: str) -> None:
    bench, other = prepare(state), Other()
    other.failure = Unavailable("there is no such driver")
    with pytest.raises(Unavailable, match=r"other cannot start: there is no such driver; arm is active again"):
        switch(bench, other)
    assert bench.machine.state().strategy == "arm"
    assert bench.arm.is_open
    assert bench.machine.state().mode == ("fault" if state == "fault" else "idle")


def test_if_neither_strategy_opens_a_reset_clears_the_fault() -> None:
    bench, other = Bench(), Other()
    other.failure, bench.arm.failure = Unavailable("no driver"), Unavailable("the disk is full")
    with pytest.raises(Unavailable, match=r"no driver; and arm cannot start again: the disk is full; .*executor/reset"):
        switch(bench, other)
    state = bench.machine.state()
    assert (state.mode, state.strategy) == ("fault", "arm")
    assert "the disk is full" in state.problem.message
    with pytest.raises(Unavailable, match="fault"):
        bench.machine.admit()
    with pytest.raises(Unavailable, match="the disk is full"):
        bench.machine.reset(arrival())
    assert bench.machine.state().mode == "fault"
    bench.arm.failure = None
    bench.machine.reset(arrival())
    bench.execute()
    bench.until("idle")
    assert bench.last().status == "succeeded"


def test_if_neither_strategy_opens_a_switch_clears_the_fault() -> None:
    bench, other = Bench(), Other()
    other.failure, bench.arm.failure = Unavailable("no driver"), Unavailable("the disk is full")
    with pytest.raises(Unavailable):
        switch(bench, other)
    other.failure = None
    switch(bench, other)
    bench.machine.reset(arrival())
    assert other.is_open
    bench.machine.admit()
    bench.machine.release()
    assert not other.is_open


def test_a_robot_that_cannot_stop_is_in_fault_after_a_switch() -> None:
    bench, other = prepare("running"), Other()
    bench.machine.set_speed(0.05)
    bench.run(0.1)
    bench.arm.deaf = True
    switch(bench, other)
    state = bench.machine.state()
    assert (state.mode, state.strategy) == ("fault", "other")
    assert "could not be stopped" in state.problem.message


def test_of_two_switches_the_second_is_busy() -> None:
    bench, other, third = prepare("running"), Other(), Other()
    with ThreadPoolExecutor(1) as pool:
        first = pool.submit(bench.machine.switch, other, PATIENCE, arrival())
        while bench.machine.state().mode == "running":
            pass
        with pytest.raises(Busy, match="being switched"):
            bench.machine.switch(third, PATIENCE, arrival())
        with pytest.raises(Busy, match="being switched"):
            bench.machine.admit(preempt=True)
        while not first.done():
            bench.tick()
        first.result()
    assert bench.machine.state().strategy == "other"
    assert third.calls == []


def test_a_goal_waiting_to_preempt_does_not_start_after_a_switch() -> None:
    bench, other = prepare("running"), Other()
    stops = arrival()
    with ThreadPoolExecutor(1) as pool:
        preempting = pool.submit(bench.machine.preempt, "goal-2", stops, PATIENCE)
        while bench.machine.state().mode == "running":
            pass
        switch(bench, other)
        with pytest.raises(Cancelled):
            preempting.result()
    assert bench.machine.state().strategy == "other"


def test_at_the_end_of_the_process_nothing_is_switched() -> None:
    bench, other = Bench(), Other()
    assert bench.machine.end(PATIENCE)
    with pytest.raises(Unavailable, match="ending"):
        bench.machine.switch(other, PATIENCE, arrival())
    assert other.calls == []
    bench.machine.release()
    assert bench.arm.calls == ["open", "close"]
