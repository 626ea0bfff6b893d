"""Plans that begin in motion: exactly in the given state, inside every limit, free, and without a stop where there is room."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.examples import examples
from support.jerk import greatest_jerk
from support.planner.second_opinion import Collisions
from support.planner.sphere_model import random_objects
from zarm_contract.errors import DeadlineExceeded, InvalidRequest, PlanningFailed
from zarm_contract.messages import (
    AddObjects,
    Cuboid,
    Goal,
    JointGoal,
    PathConstraint,
    PlanRequest,
    PoseGoal,
    SceneEdit,
    SceneObject,
    StartState,
    WaypointsGoal,
)
from zarm_contract.robot import load_robot
from zarm_geometry.exact import ExactScene
from zarm_geometry.frames import pose_of
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.context import PlanningContext
from zarm_planner.deadline import Deadline
from zarm_planner.handlers import Handlers
from zarm_planner.pipeline import Verified, plan
from zarm_planner.planners.free import FreePlanner
from zarm_planner.scene.planning_scene import PlanningScene
from zarm_planner.scene.store import SceneStore
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

MODELS = {name: RobotModel.of(load_robot(name)) for name in ("doosan_m1013", "panda")}
M1013 = MODELS["doosan_m1013"]
LIMITS = Limits.of(M1013.robot)
HOME = np.array(M1013.robot.descriptor.home)
DENSE = 0.002


def planned(
    model: RobotModel,
    start: Array,
    goal: Goal,
    *objects: SceneObject,
    motion: Array | None = None,
    seed: int = 0,
    optimize_s: float = 0.0,
) -> Verified:
    world = World(objects, 0.005)
    scene = PlanningScene("1-000000000000", model, world, ExactScene(model, world))
    context = PlanningContext(
        scene, Limits.of(model.robot), Deadline(5.0), max_attempts=5, optimize_s=optimize_s, seed=seed
    )
    return plan(FreePlanner(), context, start, goal, motion)


def to_joints(q: Array) -> JointGoal:
    return JointGoal(kind="joints", position=tuple(q.tolist()))


def goal_of(kind: str, model: RobotModel, a: Array, b: Array) -> Goal:
    one, other = pose_of(model.fk_tip(a)), pose_of(model.fk_tip(b))
    match kind:
        case "pose":
            return PoseGoal(kind="pose", position=one.position, orientation=one.orientation)
        case "set":
            return PoseGoal(kind="pose", position=one.position, orientation=one.orientation, alternatives=(other,))
        case "waypoints":
            return WaypointsGoal(kind="waypoints", through=(to_joints(a), to_joints(b)))
        case _:
            return to_joints(a)


def assert_begins_in(trajectory: TimedTrajectory, state: Array) -> None:
    np.testing.assert_allclose(trajectory.states[:, 0], state, rtol=0, atol=1e-15)  # exactly, but for the last digit
    assert not trajectory.velocity[-1].any()


def assert_inside_limits(trajectory: TimedTrajectory, model: RobotModel) -> None:
    """By finite differences of positions, but for jerk."""
    limits, h = model.robot.descriptor.cspace, 0.0005
    position, velocity, acceleration = trajectory.sample(np.arange(0.0, trajectory.duration, h))
    for rows, values, change in ((position, velocity, limits.acceleration), (velocity, acceleration, limits.jerk)):
        off = np.diff(rows, axis=0) / h - (values[1:] + values[:-1]) / 2  # they belong together, without a jump
        assert np.all(np.abs(off) <= h * np.array(change))
    assert np.all(np.abs(velocity) <= 1.001 * np.array(limits.velocity))
    assert np.all(np.abs(acceleration) <= 1.002 * np.array(limits.acceleration))
    assert np.all(greatest_jerk(trajectory) <= 1.01 * np.array(limits.jerk))
    assert np.all(position >= model.lower - 2e-4)
    assert np.all(position <= model.upper + 2e-4)


@pytest.mark.lengthy
@examples(0.5, deadline=None)
@given(
    name=st.sampled_from(sorted(MODELS)),
    kind=st.sampled_from(("joints", "pose", "set", "waypoints")),
    share=st.floats(0.0, 0.9),
    strength=st.sampled_from((0.0, 0.5, 1.0)),
    seed=st.integers(0, 2**32 - 1),
)
def test_any_moving_state_is_continued_within_limits(
    name: str, kind: str, share: float, strength: float, seed: int
) -> None:
    model, rng = MODELS[name], np.random.default_rng(seed)
    limits, home = Limits.of(model.robot), np.array(model.robot.descriptor.home)
    objects = [item for item in random_objects(10, 0.25, rng, 0.9) if not Collisions(model.robot, (item,)).at(home)]
    reach = np.maximum(model.lower, home - 1.0), np.minimum(model.upper, home + 1.0)
    q, a, b = rng.uniform(*reach, (3, model.dof))
    motion = rng.uniform(-1.0, 1.0, (2, model.dof)) * (share * limits.velocity, strength * limits.acceleration)
    try:
        found = planned(model, q, goal_of(kind, model, a, b), *objects, motion=motion, seed=seed % 1000)
    except (PlanningFailed, DeadlineExceeded):
        return  # the start or the goal is in collision, or a braking is, or there is no way between
    trajectory = found.trajectory
    assert_begins_in(trajectory, np.vstack((q, motion)))
    assert_inside_limits(trajectory, model)
    collisions = Collisions(model.robot, objects)
    positions = trajectory.positions(np.append(np.arange(0.0, trajectory.duration, 5 * DENSE), trajectory.duration))
    assert not any(map(collisions.at, positions))


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("share", [0.03, 0.3, 0.6])
def test_a_running_motion_is_taken_over_without_a_stop(name: str, share: float) -> None:
    model = MODELS[name]
    limits, home = Limits.of(model.robot), np.array(model.robot.descriptor.home)
    turned = np.array([1.0, *[0.0] * (model.dof - 1)])
    runs = planned(model, home, to_joints(home + turned)).trajectory
    state = runs.at(share * runs.duration)
    aside = home + turned
    aside[1] += 0.3
    found = planned(model, state[0], to_joints(aside), motion=state[1:]).trajectory
    assert_begins_in(found, state)
    assert_inside_limits(found, model)
    speed = np.abs(found.sample(np.arange(0.0, found.duration - 0.2, DENSE))[1] / limits.velocity).max(axis=1)
    assert speed.min() >= min(0.02, 0.9 * speed[0])
    assert found.duration < 0.9 * runs.duration + 0.3 / limits.velocity[1]


def test_time_to_optimise_makes_it_no_slower() -> None:
    motion = np.vstack((0.5 * LIMITS.velocity, np.zeros(6)))
    goal = to_joints(HOME + [-0.8, 0.2, 0, 0, 0.3, 0])
    quick, better = (planned(M1013, HOME, goal, motion=motion, optimize_s=s).trajectory for s in (0.0, 0.2))
    assert better.duration <= quick.duration


# -- what is refused --


@pytest.fixture
def handlers(tmp_path: Path) -> Handlers:
    def measured() -> Array:
        raise AssertionError("the request says where it starts")

    return Handlers(M1013, "arm", SceneStore(tmp_path), measured)


def request(position: Array, velocity: Array, **more: object) -> PlanRequest:
    state = StartState(position=tuple(position), velocity=tuple(velocity), acceleration=(0.0,) * 6)
    return PlanRequest(start_state=state, goal=to_joints(HOME), **more)  # type: ignore[arg-type]


FIRST = np.eye(6)[0]


@pytest.mark.parametrize(
    ("position", "velocity", "more", "field"),
    [
        (M1013.upper + 0.001, 0 * FIRST, {}, "start_state.position.0"),
        (HOME, 1.01 * LIMITS.velocity[0] * FIRST, {}, "start_state.velocity.0"),
        (HOME, 0.6 * LIMITS.velocity[0] * FIRST, {"velocity_scale": 0.5}, "start_state.velocity.0"),
        (
            HOME,
            0.1 * FIRST,
            {"path_constraint": PathConstraint(axes=(True, False, False, False, False, False))},
            "start_state",
        ),
    ],
)
def test_a_state_outside_the_limits_is_refused_by_field(
    handlers: Handlers, position: Array, velocity: Array, more: dict[str, object], field: str
) -> None:
    with pytest.raises(InvalidRequest) as refused:
        handlers.plan(request(position, velocity, **more))
    assert refused.value.problem.field == field


def test_without_room_to_brake_the_error_names_the_obstacle(handlers: Handlers) -> None:
    speed = 0.9 * LIMITS.velocity[0] * FIRST
    x, y, z = M1013.fk_tip(HOME + 0.5 * FIRST)[:3, 3].tolist()
    wall = Cuboid(kind="cuboid", name="wall", position=(x, y, z), size=(0.1, 0.02, 0.6))
    assert handlers.plan(request(HOME, speed)).trajectory.velocity[0] == pytest.approx(tuple(speed))
    handlers.edit(SceneEdit(edit=AddObjects(op="add", objects=(wall,))))
    with pytest.raises(PlanningFailed, match=r"no braking motion .* inside wall") as refused:
        handlers.plan(request(HOME, speed))
    assert (refused.value.code, refused.value.problem.field) == ("no_path", "start_state")


def test_without_range_to_brake_the_error_names_the_joint(handlers: Handlers) -> None:
    edge = HOME.copy()
    edge[2] = M1013.upper[2] - 0.05
    with pytest.raises(PlanningFailed, match="range") as refused:
        handlers.plan(request(edge, 0.9 * LIMITS.velocity[2] * np.eye(6)[2]))
    assert (refused.value.code, refused.value.problem.field) == ("no_path", "start_state")


@pytest.mark.parametrize(
    "state",
    [
        [
            (-2.53798563, -1.49501178, -0.20336703, 0.33596594, 2.81672611, 2.07244958),
            (0.2689509, 0.5870701, 0.6937799, -0.7395333, -0.1878412, -0.7313072),
            (0.36368, 0.79384, 0.93813, -1.0, -0.254, -0.98888),
        ],
        [
            (-0.8885901, 1.71309164, -1.56249926, -0.32729428, 0.7005742, -0.22203921),
            (0.14628682, -0.40763468, 0.4196323, 0.18025054, -0.13944497, 0.42579863),
            (0.34355554, -0.95732683, 0.98551084, 0.42331102, -0.327484, 1.0),
        ],
    ],
    ids=["at a sample", "between samples"],
)
def test_any_state_of_a_plan_is_a_valid_start(
    state: list[tuple[float, ...]],
) -> None:
    """Some 50 us apart, too little for a sample at each of these moments."""
    begun = np.array(state)
    found = planned(M1013, begun[0], to_joints(HOME), motion=begun[1:])
    assert_begins_in(found.trajectory, begun)
    assert_inside_limits(found.trajectory, M1013)


def test_a_state_and_a_start_at_rest_are_not_both_given() -> None:
    with pytest.raises(ValueError, match="start is given too"):
        request(HOME, 0 * FIRST, start=tuple(HOME))
