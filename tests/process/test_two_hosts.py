"""A workstation that plans and a machine beside the robot that executes, a router on each, and a wire that is cut in motion."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import ExitStack

import numpy as np
import pytest

from support.command_line import ZARM, vector
from support.executor.client import Client
from support.harness import PATIENCE, eventually
from support.network.lab import AWAY, Lab
from support.network.two_hosts import LOCAL, obstacle
from support.network.wire import Quality
from support.paths import EXAMPLES
from support.trajectories import HOME, KEYS, ROBOT, rest_to_rest
from zarm_contract.errors import ExecutionRefused, Unavailable
from zarm_contract.messages import (
    CancelRequest,
    ExecuteRequest,
    GoalState,
    JointState,
)

pytestmark = [
    pytest.mark.slow,  # linked routers are in cli/test_router.py, a goal that goes on without one in ros/test_router_failures.py
    pytest.mark.skipif(bool(obstacle()), reason=obstacle() or ""),
]

CUT = Quality(cut=True)
STREAM = EXAMPLES / "stream_client.py"


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    """The two hosts, which the tests of this file share."""
    with ExitStack() as stack:
        yield Lab(stack, tmp_path_factory.mktemp("hosts"))


@pytest.fixture(autouse=True)
def wire_is_whole(place: Lab) -> Iterator[None]:
    yield
    place.restore()


def end_of(client: Client, goal_id: str) -> GoalState | None:
    """The last state of a goal, where the client was told of it."""
    return next((goal for goal in client.goals if goal.goal_id == goal_id and goal.done), None)


def in_motion(client: Client, goal_id: str) -> None:
    """Wait until a goal moves the robot, as the client is told."""
    eventually(lambda: any(goal.goal_id == goal_id and goal.progress > 0.2 for goal in client.goals), "the robot moves")


def slow(place: Lab, seconds: float = 3.0) -> str:
    """Start a motion from the workstation to the other end, of so many seconds and more; its goal, which moves."""
    start = place.here.position()
    target = HOME if np.max(np.abs(start - HOME)) > 0.1 else AWAY
    motion = rest_to_rest(target, start)
    goal_id = place.here.execute(rest_to_rest(target, start, slower=max(1.0, seconds / motion.time[-1])))
    in_motion(place.here, goal_id)
    return goal_id


def test_plan_and_execute_from_the_workstation_and_both_are_told(place: Lab) -> None:
    planned = place.workstation.zarm("plan", "--joints", vector(tuple(AWAY)), "--json")
    assert planned.returncode == 0, planned.stderr
    executed = place.workstation.zarm("execute", "--json")
    assert executed.returncode == 0, executed.stderr
    goal_id = json.loads(executed.stdout)["goal_id"]
    assert json.loads(place.workstation.zarm("status", "--json").stdout)["executor"]["mode"] == "idle"
    for client in (place.here, place.there):
        end = eventually(lambda client=client: end_of(client, goal_id), "the end is told")
        assert end.status == "succeeded"
        assert client.statuses(goal_id) == ["accepted", "running", "succeeded"]
        np.testing.assert_allclose(client.position(), AWAY, atol=0.01)


def test_an_accepted_goal_survives_a_network_cut(place: Lab) -> None:
    with place.driver(place.robot):
        goal_id = slow(place)
        place.wire.become(CUT)
        end = eventually(lambda: end_of(place.there, goal_id), "the goal has ended")
        assert end.status == "succeeded"
        assert end_of(place.here, goal_id) is None
        place.restore()
        reported = eventually(lambda: place.here.goal(goal_id).status, "the workstation is told of the end")
        assert reported == "succeeded"
        place.goes_on()


def test_zarm_execute_reports_a_motion_it_did_not_see_end(place: Lab) -> None:
    planned = place.plan(*(HOME if np.max(np.abs(place.here.position() - HOME)) > 0.1 else AWAY))
    with place.workstation.runs(ZARM, "execute", "--plan-id", planned.plan_id) as command:
        goal_id = eventually(lambda: place.there.state().goal_id, "the motion begins")
        in_motion(place.there, goal_id)
        place.lose_each_other()
        eventually(lambda: end_of(place.there, goal_id), "the goal has ended")
        place.restore()
        assert command.wait(PATIENCE) == 0


def test_a_robot_cut_off_from_its_driver_rests_in_fault(place: Lab) -> None:
    reported: list[JointState] = []
    place.workstation.bus.subscribe(KEYS.driver_joint_states, lambda _, state: reported.append(state))
    with place.driver(place.workstation):
        goal_id = slow(place)
        assert any(reported[-1].velocity)
        place.wire.become(CUT)
        end = eventually(lambda: end_of(place.there, goal_id), "the executor has stopped")
        assert (end.status, end.problem and end.problem.code) == ("aborted", "driver_stalled")
        assert place.there.state().mode == "fault"
        eventually(lambda: not any(reported[-1].velocity), "the driver has stopped the robot by itself")
        rested = reported[-1].position
        place.restore()
        assert place.here.ended(goal_id).status == "aborted"
        seen = len(reported)
        eventually(lambda: len(reported) > seen + 50, "the driver tells the joints")
        assert {state.position for state in reported[seen:]} == {rested}
        assert place.here.command(KEYS.reset).mode == "idle"
        place.goes_on()


def test_a_stream_from_beyond_the_wire_ends_at_its_deadline(place: Lab) -> None:
    command = [sys.executable, str(STREAM), "--connect", LOCAL, "--seconds", "60", "--deadline", "1"]
    with place.workstation.runs(*command, "--joints", *ROBOT.descriptor.joints):
        goal_id = eventually(lambda: place.there.state().goal_id, "the stream runs")
        eventually(lambda: abs(place.there.measured[-1].velocity[0]) > 0.15, "the robot moves")
        place.wire.become(CUT)
        end = eventually(lambda: end_of(place.there, goal_id), "the stream has ended")
        assert (end.status, end.problem and end.problem.code) == ("aborted", "timeout")
        assert place.there.state().mode == "idle"
        assert place.there.stands()
        place.restore()
        assert place.here.ended(goal_id).status == "aborted"
    place.goes_on()


def test_without_the_network_nothing_is_planned_or_executed(place: Lab) -> None:
    found = place.plan(*AWAY)
    place.wire.become(CUT)

    def refused() -> bool:
        try:
            return place.plan(*AWAY) is None
        except ExecutionRefused as error:
            return error.problem.code == "no_joint_state"

    eventually(refused, "the planner misses the joints")
    bus, given_up = place.workstation.bus, "given-up"
    with pytest.raises(Unavailable):
        bus.call(KEYS.execute, ExecuteRequest(plan_id=found.plan_id, goal_id=given_up), timeout=0.5)
    with pytest.raises(Unavailable):
        bus.call(KEYS.cancel, CancelRequest(goal_id=given_up), timeout=0.5)
    place.restore()
    place.goes_on()
    assert {goal.status for goal in place.there.goals if goal.goal_id == given_up and goal.done} <= {"cancelled"}


def test_latency_and_loss_do_not_prevent_planning_and_execution(place: Lab) -> None:
    place.wire.become(Quality(delay=0.02, loss=0.05))
    for _ in range(2):
        place.goes_on()
