"""A workstation that plans and a machine beside the robot that executes, a router on each, and a wire that is cut in motion."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from burden import favour
from executor_client import Client
from harness import PATIENCE, eventually
from launched import ZARM, vector
from motions import HOME, KEYS, ROBOT, moved, rest_to_rest
from two_hosts import LOCAL, Host, Hosts, obstacle
from wire import Quality

from zarm_contract.errors import ExecutionRefused, Unavailable
from zarm_contract.messages import (
    Accepted,
    CancelRequest,
    ExecuteRequest,
    ExecutorState,
    GoalState,
    Health,
    JointGoal,
    JointState,
    Nothing,
    Plan,
    PlanRequest,
)

pytestmark = pytest.mark.skipif(bool(obstacle()), reason=obstacle() or "")

AWAY = moved(0.5, -0.3, 0.2)
CUT, WHOLE = Quality(cut=True), Quality()
STREAM = Path(__file__).parents[2] / "services" / "executor" / "examples" / "stream_client.py"


class Place(Hosts):
    """The two hosts, a planner on the workstation, an executor on the robot's, and a client on each that sees all."""

    def __init__(self, stack: ExitStack, folder: Path) -> None:
        super().__init__(stack, folder)
        self.here, self.there = Client(self.workstation.bus), Client(self.robot.bus)
        self.services = {
            name: stack.enter_context(host.service(name))
            for name, host in (("planner", self.workstation), ("executor", self.robot))
        }
        for service in self.services.values():
            service.wait_ready(self.workstation.bus, KEYS)
        self.workstation.bus.listen("zarm/**", lambda *_: None)  # as a record does: all of it goes over the wire
        eventually(lambda: self.here.measured, "the workstation hears the robot")

    def restore(self) -> None:
        """Mend the wire, and wait until the workstation hears the executor again."""
        self.wire.become(WHOLE)
        eventually(self._answers, "the workstation hears the executor")

    def goes_on(self) -> None:
        """A plan from the workstation is executed as ever, nothing was started anew, and each service is there once."""
        where = self.here.position()
        target = HOME if np.max(np.abs(where - HOME)) > 0.1 else AWAY
        found = self.plan(*target)
        end = self.here.ended(self.here.execute(plan_id=found.plan_id))
        assert end.status == "succeeded", end.problem
        np.testing.assert_allclose(self.here.position(), target, atol=0.01)
        for host in self:
            assert {one: process.process.pid for one, process in self.services.items()} == {
                one: host.bus.call(KEYS.health(one), Nothing(), Health, timeout=PATIENCE).pid for one in self.services
            }
            owners = [service for _, service, _ in host.bus.alive(KEYS.alive("*", "*"), timeout=5)]
            assert [owners.count(one) for one in self.services] == [1, 1], owners

    def _answers(self) -> bool:
        try:
            return bool(self.workstation.bus.call(KEYS.executor_state, Nothing(), ExecutorState, timeout=0.5))
        except Unavailable:
            return False

    def plan(self, *joints: float) -> Plan:
        goal = JointGoal(kind="joints", position=joints)
        return self.workstation.bus.call(KEYS.plan, PlanRequest(goal=goal), Plan, timeout=PATIENCE)

    def driver(self, host: Host) -> ExitStack:
        """The simulated driver on a host, with `joint_speed`; leaving goes back to the emulator."""
        with ExitStack() as stack:
            self.there.strategy("ghost")
            process = stack.enter_context(
                host.service("leeloo_sim", "--at", *(f"{joint:.6f}" for joint in self.there.position()))
            )
            process.wait_ready(host.bus, KEYS)
            favour(process)
            stack.callback(self.there.strategy, "emulator")
            eventually(self._driven, "the executor hears the driver")
            return stack.pop_all()

    def _driven(self) -> bool:
        try:
            return self.there.strategy("joint_speed").active == "joint_speed"
        except Unavailable:
            return False


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Place]:
    """The two hosts, which the tests of this file share."""
    with ExitStack() as stack:
        yield Place(stack, tmp_path_factory.mktemp("hosts"))


@pytest.fixture(autouse=True)
def wire_is_whole(place: Place) -> Iterator[None]:
    yield
    place.restore()


def end_of(client: Client, goal_id: str) -> GoalState | None:
    """The last state of a goal, where the client was told of it."""
    return next((goal for goal in client.goals if goal.goal_id == goal_id and goal.done), None)


def in_motion(client: Client, goal_id: str) -> None:
    """Wait until a goal moves the robot, as the client is told."""
    eventually(lambda: any(goal.goal_id == goal_id and goal.progress > 0.2 for goal in client.goals), "the robot moves")


def slow(place: Place, seconds: float = 3.0) -> str:
    """Start a motion from the workstation to the other end, of so many seconds and more; its goal, which moves."""
    start = place.here.position()
    target = HOME if np.max(np.abs(start - HOME)) > 0.1 else AWAY
    motion = rest_to_rest(target, start)
    goal_id = place.here.execute(rest_to_rest(target, start, slower=max(1.0, seconds / motion.time[-1])))
    in_motion(place.here, goal_id)
    return goal_id


def test_plan_and_execute_from_the_workstation_and_both_are_told(place: Place) -> None:
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


def test_an_accepted_goal_goes_on_to_its_end_without_the_wire_and_is_told_when_it_is_back(place: Place) -> None:
    with place.driver(place.robot):
        goal_id = slow(place)
        place.wire.become(CUT)
        end = eventually(lambda: end_of(place.there, goal_id), "the goal has ended")
        assert end.status == "succeeded"
        assert end_of(place.here, goal_id) is None
        place.restore()
        assert place.here.ended(goal_id).status == "succeeded"
        place.goes_on()


def test_zarm_execute_says_how_a_motion_ended_that_it_did_not_see_end(place: Place) -> None:
    planned = place.plan(*(HOME if np.max(np.abs(place.here.position() - HOME)) > 0.1 else AWAY))
    with place.workstation.runs(ZARM, "execute", "--plan-id", planned.plan_id) as command:
        goal_id = eventually(lambda: place.there.state().goal_id, "the motion begins")
        in_motion(place.there, goal_id)
        place.wire.become(CUT)
        eventually(lambda: end_of(place.there, goal_id), "the goal has ended")
        eventually(lambda: not place.workstation.bus.alive(KEYS.alive("executor", "*")), "the routers know")
        place.restore()
        assert command.wait(PATIENCE) == 0


def test_a_robot_whose_driver_is_beyond_the_wire_rests_and_is_in_fault(place: Place) -> None:
    told: list[JointState] = []
    place.workstation.bus.subscribe(KEYS.driver_joint_states, JointState, lambda _, state: told.append(state))
    with place.driver(place.workstation):
        goal_id = slow(place)
        assert any(told[-1].velocity)
        place.wire.become(CUT)
        end = eventually(lambda: end_of(place.there, goal_id), "the executor has stopped")
        assert (end.status, end.problem and end.problem.code) == ("aborted", "driver_stalled")
        assert place.there.state().mode == "fault"
        eventually(lambda: not any(told[-1].velocity), "the driver has stopped the robot by itself")
        rested = told[-1].position
        place.restore()
        assert place.here.ended(goal_id).status == "aborted"
        seen = len(told)
        eventually(lambda: len(told) > seen + 50, "the driver tells the joints")
        assert {state.position for state in told[seen:]} == {rested}
        assert place.here.command(KEYS.reset).mode == "idle"
        place.goes_on()


def test_a_stream_from_beyond_the_wire_ends_at_its_deadline(place: Place) -> None:
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


def test_without_the_wire_nothing_is_planned_from_old_joints_and_nothing_executed(place: Place) -> None:
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
        bus.call(KEYS.execute, ExecuteRequest(plan_id=found.plan_id, goal_id=given_up), Accepted, timeout=0.5)
    with pytest.raises(Unavailable):
        bus.call(KEYS.cancel, CancelRequest(goal_id=given_up), ExecutorState, timeout=0.5)
    place.restore()
    place.goes_on()
    assert {goal.status for goal in place.there.goals if goal.goal_id == given_up and goal.done} <= {"cancelled"}


def test_a_wire_that_is_late_and_lossy_is_good_enough_to_plan_and_execute(place: Place) -> None:
    place.wire.become(Quality(delay=0.02, loss=0.05))
    for _ in range(2):
        place.goes_on()
