"""What the servo asks for when a goal is blocked: of the planner, and of the executor."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from support.harness import eventually
from support.trajectories import HOME, ROBOT, SCENE, moved, rest_to_rest
from zarm_contract.codec import encode
from zarm_contract.errors import DeadlineExceeded, ExecutionRefused, PlanningFailed
from zarm_contract.messages import (
    GoalState,
    GoalTrajectory,
    Hold,
    JointState,
    ObjectPose,
    PathConstraint,
    Plan,
    PlanRequest,
    PlanTimings,
    Pose,
    PoseGoal,
    ReplaceTrajectory,
    Scene,
    Sphere,
)
from zarm_geometry.meshes import Meshes
from zarm_geometry.robot_model import RobotModel
from zarm_runtime.metrics import Metrics
from zarm_servo.guarding.lead import LONGEST, SHORTEST
from zarm_servo.guarding.replanning import Replanner
from zarm_servo.world.check import Checker
from zarm_servo.world.goal_monitor import FollowedGoal
from zarm_servo.world.scene_monitor import SceneSnapshot
from zarm_servo.world.world_monitor import WorldMonitor
from zarm_trajectory.trajectory import TimedTrajectory

JOINTS = ROBOT.descriptor.joints
WAY = rest_to_rest(moved(0.8), slower=2.0)
PATH = TimedTrajectory.of(WAY, JOINTS)
FOLLOWED = GoalTrajectory(goal_id="goal-1", number=1, start=0.0, trajectory=WAY, scene_revision=SCENE, replan=True)
FOLLOWED_GOAL = FollowedGoal(FOLLOWED, PATH, since=0.0, commanded=0.0, reported=0.0)
TIMINGS = PlanTimings(ik=0, search=0, shortcut=0, timing=0, verify=0, optimize=0, total=0)
PLAN = Plan(
    plan_id="p-1",
    robot="arm",
    robot_hash=ROBOT.hash,
    scene_revision=SCENE,
    trajectory=WAY,
    tip=Pose(position=(0.0, 0.0, 1.0)),
    clearance=0.1,
    resolution=0.01,
    path_length=1.0,
    timings=TIMINGS,
)


class Standing:
    """Joints that are measured at rest, or not."""

    rests = False

    def get(self, *, max_age: float) -> JointState:
        speed = 0.0 if self.rests else 0.5
        return JointState(stamp=max_age, joint_names=JOINTS, position=tuple(HOME), velocity=(speed,) * len(JOINTS))


class Peers:
    """Planner and executor as the test has them answer; what they were asked."""

    def __init__(self) -> None:
        self.asked: list[PlanRequest] = []
        self.replaced: list[ReplaceTrajectory] = []
        self.planner: Callable[[], Plan] = lambda: PLAN
        self.executor: Callable[[], None] = lambda: None
        self.measured = Standing()
        self.world = WorldMonitor(self.measured, Meshes(), ROBOT.descriptor)  # type: ignore[arg-type]
        self.world.scene.on_scene("", Scene(revision=SCENE))
        self.lock = threading.Lock()

    def ask(self, request: PlanRequest, _deadline: float) -> Plan:
        self.asked.append(request)
        return self.planner()

    def replace(self, request: ReplaceTrajectory) -> None:
        self.executor()
        self.replaced.append(request)


def goal(progress: float, *, held: bool = False) -> GoalState:
    return GoalState(
        goal_id="goal-1",
        status="running",
        progress=progress,
        elapsed=0.1,
        duration=PATH.duration,
        joint_command=tuple(HOME),
        hold=Hold(reason="obstruction") if held else None,
    )


@pytest.fixture
def peers() -> Peers:
    return Peers()


@pytest.fixture(scope="module")
def checker() -> Checker:
    """It has checked something: the first time takes long."""
    made = Checker(RobotModel.of(ROBOT), Meshes())
    ball = Sphere(kind="sphere", name="ball", position=(0.0, 0.0, 9.0), radius=0.1)
    made.validity(PATH, 0.0, SceneSnapshot(objects={"ball": ball}), None)
    return made


@pytest.fixture
def replanner(peers: Peers, checker: Checker) -> Iterator[Replanner]:
    with Replanner(ROBOT, checker, peers.world, peers.ask, peers.replace, Metrics()) as running:
        running.on_goal(goal(0.2))
        yield running


def test_a_constrained_goal_is_replanned_at_rest(peers: Peers, replanner: Replanner) -> None:
    upright = PathConstraint(axes=(True, True, False, False, False, False))
    message = FOLLOWED.model_copy(update={"path_constraint": upright})
    held = FollowedGoal(message, PATH, since=0.0, commanded=0.0, reported=0.0)
    replanner.on_validity(held, PATH.duration - 0.1)
    peers.measured.rests = True
    replanner.on_goal(goal(0.3, held=True))
    replanner.on_validity(held, PATH.duration - 0.1)
    (replaced,) = eventually(lambda: list(peers.replaced), "the trajectory is replaced")
    (request,) = peers.asked
    assert (request.start_state, replaced.at) == (None, None)
    assert request.path_constraint == upright


def test_a_blocked_goal_is_replanned_from_a_state_ahead(peers: Peers, replanner: Replanner) -> None:
    replanner.on_validity(FOLLOWED_GOAL, PATH.duration - 0.1)
    (replaced,) = eventually(lambda: list(peers.replaced), "the trajectory is replaced")
    (request,) = peers.asked
    assert replaced.at is not None
    assert (replaced.goal_id, replaced.number, replaced.scene_revision) == ("goal-1", 1, SCENE)
    assert replaced.at >= 0.2 * PATH.duration + SHORTEST
    assert request.start_state is not None
    np.testing.assert_allclose(request.start_state.position, PATH.at(replaced.at)[0])
    np.testing.assert_allclose(request.goal.position, PATH.end)
    assert request.velocity_scale is not None
    assert request.velocity_scale < 0.6


def test_a_pose_goal_is_replanned_to_other_joints(peers: Peers, replanner: Replanner) -> None:
    def planner() -> Plan:
        if peers.asked[-1].goal.kind == "joints":
            raise PlanningFailed("something stands there", code="goal_in_collision")
        return PLAN

    peers.planner = planner
    tip = Pose(position=(0.4, 0.0, 0.6))
    replanner.on_validity(replace(FOLLOWED_GOAL, message=FOLLOWED.model_copy(update={"tip": tip})), PATH.duration - 0.1)
    eventually(lambda: peers.replaced, "the trajectory is replaced")
    goal = peers.asked[-1].goal
    assert isinstance(goal, PoseGoal)
    assert goal.poses == (tip,)


def test_a_late_replan_starts_later_and_then_from_rest(peers: Peers, replanner: Replanner) -> None:
    refusals: list[int] = []

    def refuse() -> None:
        refusals.append(len(peers.asked))
        raise ExecutionRefused("too late", code="start_state_mismatch")

    peers.executor = refuse
    replanner.on_validity(FOLLOWED_GOAL, PATH.duration - 0.1)
    eventually(lambda: len(refusals) == 4, "it was tried four times")
    leads = [request.timeout for request in peers.asked]
    assert leads == sorted(leads)
    assert leads[-1] <= LONGEST
    peers.executor = lambda: None
    peers.measured.rests = True
    replanner.on_goal(goal(0.5, held=True))

    def again() -> list[ReplaceTrajectory]:
        replanner.on_validity(FOLLOWED_GOAL, PATH.duration - 0.1)
        return peers.replaced

    (replaced,) = eventually(again, "it is replaced at rest")
    assert replaced.at is None
    assert peers.asked[-1].start_state is None


@pytest.mark.parametrize(
    "failure", [PlanningFailed("no way", code="no_path"), DeadlineExceeded("slow", code="timeout")]
)
def test_without_a_plan_nothing_is_replaced(peers: Peers, replanner: Replanner, failure: Exception) -> None:
    def fail() -> Plan:
        raise failure

    peers.planner = fail
    replanner.on_validity(FOLLOWED_GOAL, PATH.duration - 0.1)
    eventually(lambda: peers.asked, "the planner was asked")
    assert not peers.replaced


def test_a_replan_in_collision_in_a_newer_scene_is_dropped(peers: Peers, replanner: Replanner) -> None:
    def overtaken() -> Plan:
        middle = RobotModel.of(ROBOT).fk_tip(PATH.positions(np.array([PATH.duration / 2]))[0])[:3, 3]
        ball = Sphere(kind="sphere", name="ball", position=tuple(middle.tolist()), radius=0.1)
        newer = f"{int(SCENE.partition('-')[0]) + 1}-{SCENE.partition('-')[2]}"
        peers.world.scene.on_scene("", Scene(revision=newer, objects=(ball,)))
        return PLAN

    peers.planner = overtaken
    replanner.on_validity(FOLLOWED_GOAL, PATH.duration - 0.1)
    eventually(lambda: len(peers.asked) > 1, "it was tried again")
    assert not peers.replaced


def test_a_plan_that_is_not_free_of_what_moves_is_not_followed(peers: Peers, replanner: Replanner) -> None:
    ball = Sphere(kind="sphere", name="ball", position=(0.0, 0.0, 9.0), radius=0.1)
    peers.world.scene.on_scene("", Scene(revision=SCENE, objects=(ball,)))
    middle = RobotModel.of(ROBOT).fk_tip(PATH.positions(np.array([PATH.duration / 2]))[0])[:3, 3]
    pose = ObjectPose(stamp=time.time(), position=tuple(middle.tolist()), speed=0.1)
    peers.world.moving.update_object("ball", encode(pose), time.monotonic(), time.time())
    replanner.on_validity(FOLLOWED_GOAL, PATH.duration - 0.1)
    eventually(lambda: len(peers.asked) > 1, "it was tried again")
    assert not peers.replaced


@pytest.mark.parametrize(("lag", "followed"), [(0.0, True), (5.0, False)])
def test_a_replan_is_dropped_if_a_lagging_robot_cannot_stop(
    peers: Peers, replanner: Replanner, lag: float, *, followed: bool
) -> None:
    ball = Sphere(kind="sphere", name="ball", position=(0.0, 0.0, 9.0), radius=0.1)
    peers.world.scene.on_scene("", Scene(revision=SCENE, objects=(ball,)))
    x, y, z = RobotModel.of(ROBOT).fk_tip(PATH.positions(np.array([PATH.duration / 2]))[0])[:3, 3].tolist()
    pose = ObjectPose(stamp=time.time(), position=(1.5 * x, 1.5 * y, z), speed=0.1)
    peers.world.moving.update_object("ball", encode(pose), time.monotonic(), time.time())
    peers.world.lag.on_goal(GoalState.model_construct(lag=lag))
    replanner.on_validity(FOLLOWED_GOAL, PATH.duration - 0.1)
    eventually(lambda: peers.replaced or len(peers.asked) > 1, "it was followed, or tried again")
    assert bool(peers.replaced) == followed


def test_a_goal_blocked_too_soon_is_not_replanned_in_motion(peers: Peers, replanner: Replanner) -> None:
    peers.measured.rests = True
    replanner.on_goal(goal(0.2, held=True))
    replanner.on_validity(FOLLOWED_GOAL, 0.2 * PATH.duration)

    def again() -> list[ReplaceTrajectory]:
        replanner.on_validity(FOLLOWED_GOAL, 0.2 * PATH.duration)
        return peers.replaced

    (replaced,) = eventually(again, "it is replaced at rest")
    assert replaced.at is None
