"""`import zarm`, as a program uses it: what it promises beside the examples."""

from __future__ import annotations

import asyncio
import inspect
import itertools
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import zarm
import zarm.aio
from support.command_line import HOME, ROBOT, pid
from support.harness import PATIENCE, eventually, free_endpoint
from zarm.executor import Executor
from zarm.planner import Planner
from zarm.servo import Servo
from zarm_contract.messages import MAX_POINTS, GoalState
from zarm_runtime.bus import Bus

ELSEWHERE = (1.2, *HOME[1:])
SLOWLY = 0.12
PROGRAM = f"""
import signal
from zarm import Robot
from zarm.connection import connected
from zarm.interrupts import CtrlC

class ToldOf(CtrlC):
    def insist(self, awaited):
        print("waiting for", awaited, flush=True)
        return super().insist(awaited)

signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore Ctrl-C, and so would this
with connected(interrupts=ToldOf()) as connection:
    robot = Robot(connection)
    robot.execute(robot.plan({ELSEWHERE}, velocity_scale={SLOWLY}))
"""


@pytest.fixture
def robot(place: str, empty_scene: None) -> Iterator[zarm.Robot]:
    """The robot at home, at rest at the end."""
    with zarm.connect(place) as found:
        if not np.allclose(found.joint_state().position, HOME, atol=1e-3):
            found.execute(found.plan(HOME))
        yield found
        assert found.state().mode == "idle"


def on_its_way(robot: zarm.Robot) -> None:
    eventually(lambda: robot.joint_state().position[0] > 0.05, "the robot is on its way")


def program(place: str) -> subprocess.Popen[str]:
    environment = os.environ | {"ZARM_CONNECT": place}
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


# -- what may be given --


def test_numpy_arrays_are_taken_wherever_numbers_are(robot: zarm.Robot) -> None:
    box = zarm.Cuboid("box", size=np.full(3, 0.1), position=np.array([0.0, -0.8, 0.2], dtype=np.float32))
    cloud = zarm.PointCloud("cloud", np.array([[0.0, -0.8, 0.8], [0.1, -0.8, 0.8]]))
    assert robot.scene.add(box, cloud).count == 2
    assert robot.scene.objects()["box"] == box
    assert isinstance(robot.scene.objects()["cloud"], zarm.Voxels)
    plan = robot.plan(np.array(ELSEWHERE))
    clearances = [found.clearance for found in robot.check(np.array(plan.trajectory.position))]
    assert min(clearances) == pytest.approx(plan.clearance, abs=0.002)
    assert np.allclose(robot.ik(robot.fk(np.array([HOME]))[0], near=np.array(HOME))[0], HOME, atol=1e-4)


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: zarm.Pose((0.0, 0.0)), "position.2"),
        (lambda: zarm.Pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 2.0)), "orientation"),
        (lambda: zarm.Cuboid("box", size=(1, 0, 1), position=(0, 0, 0)), "size.1"),
        (lambda: zarm.Sphere("no name", radius=1, position=(0, 0, 0)), "name"),
        (lambda: zarm.PathConstraint(("x", "w")), "axes"),  # type: ignore[arg-type]
        (lambda: zarm.PointCloud("cloud", "abc"), "points"),
    ],
)
def test_what_cannot_be_is_an_error_of_zarm_that_names_the_field(make: object, field: str) -> None:
    with pytest.raises(zarm.InvalidRequest) as refused:
        make()  # type: ignore[operator]
    assert isinstance(refused.value, zarm.Error)
    assert refused.value.problem.field == field


def test_goal_with_freedom_is_planned_and_solved(robot: zarm.Robot) -> None:
    (there,) = robot.fk([ELSEWHERE])
    plan = robot.plan(zarm.PoseGoal(there.position), start=HOME)
    assert plan.tip.position == pytest.approx(there.position, abs=1e-5)
    about = zarm.PoseGoal(there, free=["theta_z"], tolerance={"x": 0.01})
    assert abs((robot.plan(about, start=HOME).goal_deviation or (1.0,) * 6)[3]) <= 0.01
    assert robot.ik(about, near=HOME)
    link = robot.plan(zarm.PoseGoal(there, tip=zarm.TipFrame("link_6")), start=HOME)
    assert link.trajectory.position


def test_lines_arcs_and_paths_of_the_tip_are_planned(robot: zarm.Robot) -> None:
    x, y, z = robot.fk([HOME])[0].position
    line = robot.plan(zarm.Line((x, y + 0.2, z), speed=0.1, free=["theta_z"]), start=HOME)
    arc = robot.plan(zarm.Arc((x, y + 0.2, z), via=(x + 0.07, y + 0.1, z), orienting="tangent"), start=HOME)
    path = robot.plan(zarm.Path((x, y + 0.2, z), (x, y + 0.2, z - 0.1), blend=0.02), start=HOME)
    lengths = [plan.tool.length for plan in (line, arc, path) if plan.tool is not None]
    assert lengths == pytest.approx([0.2, 0.2535, 0.298], abs=0.01)


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: zarm.Line((0.1, 0.2, 0.3), free=["x"]), "free"),  # type: ignore[list-item]
        (lambda: zarm.Line((0.1, 0.2, 0.3), speed=0.0), "speed"),
        (lambda: zarm.PoseGoal((0.1, 0.2, 0.3), tolerance={"roll": 0.1}), "tolerance"),
        (lambda: zarm.PoseGoal((0.1, 0.2, 0.3), tolerance={"x": -0.1}), "position.0"),
        (lambda: zarm.PoseGoal((0.1, 0.2, 0.3), tolerance={"x": 0.1}, radius=0.1), "radius"),
    ],
)
def test_freedom_that_makes_no_sense_is_refused_by_argument(make: object, field: str) -> None:
    with pytest.raises(zarm.InvalidRequest) as refused:
        make()  # type: ignore[operator]
    assert refused.value.problem.field == field


def test_of_several_poses_the_one_reached_soonest_is_chosen(robot: zarm.Robot) -> None:
    there, near = robot.fk([ELSEWHERE, [(a + 3 * b) / 4 for a, b in zip(ELSEWHERE, HOME, strict=True)]])
    plan = robot.plan(zarm.AnyOf(zarm.Pose((5.0, 0.0, 0.5)), there, near), start=HOME)
    assert plan.selected_goal_index == 2
    assert plan.tip.position == pytest.approx(near.position, abs=1e-5)
    through = robot.plan(zarm.Waypoints(zarm.AnyOf(there, near), HOME), start=HOME)
    assert len(through.waypoint_times) == 2
    assert through.selected_goal_index is None


def test_a_plan_begins_in_the_motion_that_it_is_to_take_over(robot: zarm.Robot) -> None:
    runs = robot.plan(ELSEWHERE, start=HOME).trajectory
    at = len(runs.time) // 2
    state = zarm.StartState(runs.position[at], np.array(runs.velocity[at]), runs.acceleration[at])
    back = robot.plan(HOME, start=state).trajectory
    assert (back.position[0], back.velocity[0], back.acceleration[0]) == (
        state.position,
        state.velocity,
        state.acceleration,
    )
    assert back.position[-1] == pytest.approx(HOME)
    with pytest.raises(zarm.InvalidRequest, match="path constraint"):
        robot.plan(HOME, start=state, path_constraint=zarm.PathConstraint(("z",)))


def test_what_a_service_refuses_is_the_error_that_it_stands_for(robot: zarm.Robot) -> None:
    with pytest.raises(zarm.PlanningFailed):
        robot.plan(zarm.Pose((5.0, 0.0, 0.5)))
    with pytest.raises(zarm.InvalidRequest, match="6 joints"):
        robot.plan((0.0, 0.0))
    with pytest.raises(zarm.InvalidRequest, match="nothing"):
        robot.scene.remove("nothing")
    with pytest.raises(zarm.InvalidRequest, match=r"speed_scale"):
        robot.speed(2.0)


# -- who there is --


def test_a_robot_is_found_by_itself_or_by_name(place: str) -> None:
    assert zarm.robots(place) == [ROBOT]
    with zarm.connect(place, ROBOT) as robot:
        assert robot.name == ROBOT
    with zarm.connect(place, "nobody") as nobody, pytest.raises(zarm.Unavailable):
        nobody.stop()
    with pytest.raises(zarm.InvalidRequest), zarm.connect(place, "No Name"):
        pass
    with pytest.raises(zarm.Unavailable), zarm.connect(free_endpoint()):
        pass


# -- motion --


def test_the_progress_of_a_goal_is_told_up_to_its_end(robot: zarm.Robot) -> None:
    reported: list[GoalState] = []
    last = robot.execute(robot.plan(ELSEWHERE), on_progress=reported.append)
    assert reported[-1] == last
    assert last.status == "succeeded"
    assert len(reported) > 3
    assert all(before.progress <= after.progress for before, after in itertools.pairwise(reported))


def test_a_started_goal_is_followed_and_cancelled_by_id(robot: zarm.Robot) -> None:
    goal = robot.start(robot.plan(ELSEWHERE, velocity_scale=SLOWLY))
    on_its_way(robot)
    with pytest.raises(zarm.Busy):
        robot.execute()
    robot.cancel(goal)
    assert robot.follow(goal).status == "cancelled"


def test_who_executes_a_goal_that_another_client_ends_is_told_so(robot: zarm.Robot, place: str) -> None:
    plan = robot.plan(ELSEWHERE, velocity_scale=SLOWLY)
    with zarm.connect(place) as other, pytest.raises(zarm.Cancelled):
        robot.execute(plan, on_progress=lambda goal: goal.progress > 0.1 and other.stop())


@pytest.mark.slow  # as an exception in a stream does
def test_an_exception_in_the_progress_callback_stops_the_robot(robot: zarm.Robot) -> None:
    def fail(goal: GoalState) -> None:
        if goal.progress > 0.1:
            raise LookupError("enough")

    with pytest.raises(LookupError):
        robot.execute(robot.plan(ELSEWHERE, velocity_scale=SLOWLY), on_progress=fail)
    assert robot.state().mode == "idle"
    assert robot.joint_state().position[0] < 0.9


def test_ctrl_c_stops_the_robot_before_the_program_goes_on(robot: zarm.Robot, place: str) -> None:
    with program(place) as running:
        on_its_way(robot)
        running.send_signal(signal.SIGINT)
        _, errors = running.communicate(timeout=PATIENCE)
    assert "KeyboardInterrupt: cancelled: the robot stands still at" in errors.splitlines()[-1]
    assert robot.state().mode == "idle"


@pytest.mark.slow
def test_a_second_ctrl_c_leaves_a_hanging_executor(robot: zarm.Robot, place: str, observer: Bus) -> None:
    executor = pid(observer, "executor")
    with program(place) as running:
        on_its_way(robot)
        os.kill(executor, signal.SIGSTOP)
        try:
            running.send_signal(signal.SIGINT)
            assert running.stdout is not None
            while "to rest" not in running.stdout.readline():  # two at once would count as one
                assert running.poll() is None
            running.send_signal(signal.SIGINT)
            running.wait(PATIENCE)
        finally:
            os.kill(executor, signal.SIGCONT)
        _, errors = running.communicate(timeout=PATIENCE)
    assert "the state of the robot is unknown" in errors
    eventually(lambda: robot.state().mode == "idle", "the robot was cancelled all the same")


# -- live --


def test_states_and_joints_are_live_and_end_with_their_loop(robot: zarm.Robot) -> None:
    modes: list[str] = []
    plan = robot.plan(ELSEWHERE)
    moving = threading.Thread(target=robot.execute, args=[plan])
    for state in robot.states():
        if not modes:
            moving.start()
        modes.append(state.mode)
        if modes[-2:] == ["running", "idle"]:
            break
    moving.join()
    assert modes[0] == "idle"
    seen = [state.stamp for state in itertools.islice(robot.joint_states(), 20)]
    assert seen == sorted(set(seen))


# -- streams --


def test_a_stream_that_is_not_gone_on_with_brakes_and_says_so(robot: zarm.Robot) -> None:
    plan = robot.plan(ELSEWHERE, velocity_scale=SLOWLY)

    def send_once() -> None:
        with robot.stream(deadline=0.2) as stream:
            stream.send(plan.trajectory)
            eventually(lambda: not stream.running, "the deadline has passed")
            stream.send(plan.trajectory)

    with pytest.raises(zarm.DeadlineExceeded):
        send_once()
    assert robot.joint_state().position[0] < 0.9


def test_leaving_a_stream_without_a_final_chunk_stops_the_robot(robot: zarm.Robot) -> None:
    plan = robot.plan(ELSEWHERE, velocity_scale=SLOWLY)
    with robot.stream(deadline=1.0) as stream:
        stream.send(plan.trajectory)
        eventually(lambda: stream.state is not None, "the stream has begun")
    assert stream.state is not None
    assert stream.state.status == "cancelled"


def test_a_stream_that_is_left_by_an_exception_is_cancelled(robot: zarm.Robot) -> None:
    plan = robot.plan(ELSEWHERE, velocity_scale=SLOWLY)
    left: list[zarm.Stream] = []

    def leave() -> None:
        with robot.stream(deadline=1.0) as stream:
            left.append(stream)
            while robot.joint_state().position[0] < 0.05:
                stream.send(plan.trajectory, start=0.0)
            raise LookupError

    with pytest.raises(LookupError):
        leave()
    assert left[0].state is not None
    assert left[0].state.status == "cancelled"


# -- asyncio --


def test_the_asynchronous_client_does_the_same(robot: zarm.Robot, place: str) -> None:
    async def main() -> tuple[GoalState, list[str], bool]:
        async with zarm.aio.connect(place) as arm:
            await arm.scene.add(zarm.Sphere("ball", radius=0.05, position=(0.0, -0.8, 0.2)))
            assert "ball" in await arm.scene.objects()
            reported: list[str] = []
            loop_thread = threading.current_thread()
            in_loop: list[bool] = []

            def progress(goal: GoalState) -> None:
                reported.append(goal.status)
                in_loop.append(threading.current_thread() is loop_thread)

            last = await arm.execute(await arm.plan(ELSEWHERE), on_progress=progress)
            async for state in arm.joint_states():
                assert state.position == pytest.approx(ELSEWHERE, abs=0.01)
                break
            return last, reported, all(in_loop)

    last, reported, in_loop = asyncio.run(main())
    assert last.status == reported[-1] == "succeeded"
    assert in_loop


def test_a_task_that_is_cancelled_has_stopped_the_robot(robot: zarm.Robot, place: str) -> None:
    async def main() -> str:
        async with zarm.aio.connect(place) as arm:
            task = asyncio.create_task(arm.execute(await arm.plan(ELSEWHERE, velocity_scale=SLOWLY)))
            async for state in arm.joint_states():
                if state.position[0] > 0.05:
                    break
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
            return (await arm.state()).mode

    assert asyncio.run(main()) == "idle"


@pytest.mark.slow  # the asynchronous client shares all but the waiting
def test_an_asynchronous_stream_is_played_to_its_end(robot: zarm.Robot, place: str, tmp_path: Path) -> None:
    file = tmp_path / "stream.mcap"

    async def main() -> None:
        async with zarm.aio.connect(place) as arm, arm.record(file):
            plan = await arm.plan((0.2, *HOME[1:]), velocity_scale=0.5, acceleration_scale=0.3)
            async with arm.stream(deadline=1.0) as stream:
                stream.send(plan.trajectory, last=True)

    asyncio.run(main())
    assert robot.joint_state().position[0] == pytest.approx(0.2, abs=0.01)
    assert any("succeeded" in event.what for event in zarm.story(file).events)


# -- after the with --


def test_a_closed_client_says_that_it_is_closed(place: str, robot: zarm.Robot) -> None:
    with zarm.connect(place) as left:
        scene, states, joints = left.scene, left.states(), left.joint_states()
        goal_id = left.start(left.plan(HOME))
        left.follow(goal_id)
        next(states)
        next(joints)
    calls = {
        "plan": lambda: left.plan(HOME),
        "execute": lambda: left.execute("plan-1"),
        "follow": lambda: left.follow(goal_id),
        "stop": left.stop,
        "state": left.state,
        "states": lambda: next(left.states()),
        "states from before": lambda: next(states),
        "joint states from before": lambda: next(joints),
        "tip": left.tip,
        "scene": scene.objects,
        "add": lambda: scene.add(zarm.Sphere("ball", position=(0, 0, 9), radius=0.1)),
        "track": lambda: left.track().__enter__(),
        "stream": lambda: left.stream().__enter__(),
    }
    for name, call in calls.items():
        try:
            refused = f"not refused: {call()}"
        except zarm.Unavailable as error:
            refused = str(error)
        assert "the connection is closed" in refused, name


def test_a_closed_async_client_says_that_it_is_closed(place: str, robot: zarm.Robot) -> None:
    async def use() -> None:
        async with zarm.aio.connect(place) as left:
            await left.state()
        with pytest.raises(zarm.Unavailable, match="the connection is closed"):
            await left.state()

    asyncio.run(use())


def test_the_largest_cloud_goes_through_with_every_digit(robot: zarm.Robot) -> None:
    points = np.random.default_rng(0).uniform((5.0, -1.0, 0.0), (6.0, 1.0, 2.0), (MAX_POINTS, 3))
    assert robot.scene.add(zarm.PointCloud("seen", points, resolution=0.05)).count == 1
    cells = np.unique(np.rint(points / 0.05).astype(int), axis=0)
    found = robot.scene.objects()["seen"]
    assert isinstance(found, zarm.Voxels)
    assert {tuple(cell) for cell in found.cells} == {tuple(cell) for cell in cells.tolist()}


@pytest.mark.parametrize("part", [Planner, Executor, Servo])
def test_every_method_of_a_part_has_a_short_form_on_the_robot(part: type) -> None:
    methods = {name for name, _ in inspect.getmembers(part, inspect.isfunction) if not name.startswith("_")}
    assert methods <= {name for name, _ in inspect.getmembers(zarm.Robot, inspect.isfunction)}
