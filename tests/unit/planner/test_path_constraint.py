"""What holding axes promises: the tip keeps what is held, all along, and what cannot be kept is refused by name."""

from __future__ import annotations

import re
import threading
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.examples import examples
from support.planner.second_opinion import link_pose
from support.planner.small_arm import small_arm
from support.planner.sphere_model import clearances, random_objects
from support.tiers import sampled
from zarm_contract.messages import Cuboid, PathConstraint, SceneObject
from zarm_contract.robot import load_robot
from zarm_geometry.collision import is_free
from zarm_geometry.kernels.collision import RESOLUTION
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.constraints.constrained_search import search_constrained, shortcut_constrained
from zarm_planner.constraints.constrained_timing import time_constrained
from zarm_planner.constraints.path_constraint import ConstraintManifold
from zarm_planner.deadline import Deadline
from zarm_planner.kernels.manifold import CLOSE
from zarm_planner.kinematics.ik import solve_ik
from zarm_planner.timing.sampling import load
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

DT = 0.02
UPRIGHT = PathConstraint(axes=(True, True, False, False, False, False))
LEVEL = PathConstraint(axes=(False, False, False, False, False, True))
LINE = PathConstraint(axes=(True, True, True, False, True, True), frame="tool")
STILL = PathConstraint(axes=(True, True, True, True, True, True))
KINDS = (
    UPRIGHT,
    LEVEL,
    LINE,
    PathConstraint(axes=(True, True, True, False, False, False), angle_tolerance=0.001),
    PathConstraint(axes=(False, False, True, True, False, False), frame="tool", position_tolerance=0.0005),
    PathConstraint(axes=(False, False, False, True, True, True)),
)
WALL = (Cuboid(kind="cuboid", name="wall", position=(0.6, 0.0, 0.2), size=(0.8, 0.02, 0.4)),)
MODELS = {name: RobotModel.of(load_robot(name)) for name in ("panda", "ur5e", "doosan_m1013")}
PANDA = MODELS["panda"]


@pytest.fixture(scope="module")
def sides() -> tuple[Array, Array]:
    """The hand of the Panda to the left and to the right of the wall, pointing down."""
    left = np.array([0.5, 0.35, 0.0, -2.1, 0.0, 2.45, 0.785])
    return left, left * [-1, 1, 1, 1, 1, 1, 1]


def rotation(vector: Array) -> Array:
    """Rodrigues' formula."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector / max(angle, 1e-300)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turn: Array = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return turn


def tip(model: RobotModel, q: Array) -> Array:
    """From the URDF, by other code than the planner's."""
    return link_pose(model.robot, model.robot.descriptor.tip_link, q)


def log(turn: Array) -> Array:
    """The rotation vector of a rotation, by its eigenvector."""
    values, vectors = np.linalg.eig(turn)
    axis = np.real(vectors[:, np.argmin(np.abs(values - 1.0))])
    sine = axis @ [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]] / 2
    vector: Array = axis * np.arctan2(sine, (np.trace(turn) - 1.0) / 2)
    return vector


def used(model: RobotModel, message: PathConstraint, start: Array, q: Array) -> float:
    """The largest part of a tolerance that `q` uses, as the message defines it."""
    a, b = tip(model, start), tip(model, q)
    turn, shift = log(b[:3, :3] @ a[:3, :3].T), b[:3, 3] - a[:3, 3]
    if message.frame == "tool":
        turn, shift = log(a[:3, :3].T @ b[:3, :3]), a[:3, :3].T @ shift
    allowed = np.repeat((message.angle_tolerance, message.position_tolerance), 3)
    return float(np.max(np.abs(np.concatenate((turn, shift)) / allowed)[list(message.axes)]))


def assert_kept(model: RobotModel, message: PathConstraint, motion: TimedTrajectory) -> None:
    """At ten moments per sample, by the second opinion; and inside the limits, from rest to rest."""
    moments = np.linspace(0.0, motion.duration, 10 * len(motion.time))
    positions, _, _ = motion.sample(moments)
    held = ConstraintManifold.of(model, message, motion.position[0])
    assert held.use(positions).max() <= 1.0
    assert held.violation(positions) is None
    worst = np.argsort(held.use(positions))[-20:]
    rows = np.unique(np.concatenate((worst, np.arange(0, len(moments), 25))))
    assert max(used(model, message, motion.position[0], positions[row]) for row in rows) <= 1.0 + 1e-6
    assert load(motion, Limits.of(model.robot)) <= 1.001
    assert not motion.velocity[[0, -1]].any()
    assert np.all((positions >= model.lower - 1e-4) & (positions <= model.upper + 1e-4))


def plan_held(
    world: World,
    held: ConstraintManifold,
    start: Array,
    goals: Array,
    limits: Limits,
    *,
    seed: int,
    deadline: Deadline,
    most: int = 10_000,
) -> TimedTrajectory | None:
    """A motion that keeps what is held, free of `world` in spheres; None where none is found."""
    path = search_constrained(world, held, start, goals, seed=seed, deadline=deadline, most=most)
    if path is None:
        return None
    path = shortcut_constrained(world, held, path, seed=seed, deadline=deadline)
    return time_constrained(
        held, path, limits, DT, free=lambda rows: is_free(held.model, world, rows), deadline=deadline
    )


def problem(
    model: RobotModel, message: PathConstraint, rng: np.random.Generator
) -> tuple[tuple[SceneObject, ...], ConstraintManifold, Array, Array]:
    """Objects, and a free start and free goals that keep what is held, at random."""
    while True:
        objects = random_objects(4, 0.25, rng)
        start = rng.uniform(model.lower, model.upper)
        held = ConstraintManifold.of(model, message, start)
        near = held.projected(rng.uniform(model.lower, model.upper))
        pose = model.fk_tip(start if near is None else near[0])
        if message is LINE:
            pose = model.fk_tip(start)
            pose[:3, 3] += rng.uniform(-0.3, 0.3) * pose[:3, 0]
        world = World(objects, 0.005)
        goals = solve_ik(model, pose, start, world=world, max_solutions=16, seed=0, deadline=Deadline(30.0)).solutions
        if len(goals) and is_free(model, world, start):
            return objects, held, start, goals


@pytest.mark.lengthy
@pytest.mark.parametrize("message", KINDS)
@pytest.mark.parametrize("name", sampled("panda", *sorted(set(MODELS) - {"panda"})))
def test_in_random_worlds_constraints_and_limits_hold(name: str, message: PathConstraint) -> None:
    model, rng, planned = MODELS[name], np.random.default_rng(0), 0
    for seed in range(3):
        objects, held, start, goals = problem(model, message, rng)
        world = World(objects, 0.005)
        motion = plan_held(
            world, held, start, goals, Limits.of(model.robot), seed=seed, deadline=Deadline(30.0), most=50
        )
        if motion is None:  # obstacles and joint ranges can cut a goal off
            continue
        planned += 1
        np.testing.assert_array_equal(motion.position[0], start)
        assert np.abs(goals - motion.position[-1]).max(axis=1).min() == 0.0
        assert_kept(model, message, motion)
        assert clearances(model, objects, motion.position).min() > -RESOLUTION / 2
    assert planned > 0


@pytest.mark.parametrize("seed", sampled(*range(3)))
@pytest.mark.parametrize("message", [UPRIGHT, PathConstraint(axes=(True, True, True, False, False, False))])
def test_a_glass_is_carried_upright_around_a_wall(
    sides: tuple[Array, Array], message: PathConstraint, seed: int
) -> None:
    start, goal = sides
    world = World(WALL, 0.005)
    held = ConstraintManifold.of(PANDA, message, start)
    pose = PANDA.fk_tip(goal)
    pose[:3, :3] = PANDA.fk_tip(start)[:3, :3]
    goals = solve_ik(PANDA, pose, start, world=world, max_solutions=16, seed=0, deadline=Deadline(30.0)).solutions
    motion = plan_held(world, held, start, goals, Limits.of(PANDA.robot), seed=seed, deadline=Deadline(30.0))
    assert motion is not None
    assert_kept(PANDA, message, motion)
    assert clearances(PANDA, WALL, motion.position).min() > -RESOLUTION / 2
    assert PANDA.fk_tip(motion.position)[:, 2, 3].max() > pose[2, 3] + 0.05  # over it, not through it


def test_the_same_seed_gives_the_same_constrained_motion(sides: tuple[Array, Array]) -> None:
    start, goal = sides
    world, held = World(WALL, 0.005), ConstraintManifold.of(PANDA, UPRIGHT, start)
    motions = [
        plan_held(world, held, start, goal[None], Limits.of(PANDA.robot), seed=seed, deadline=Deadline(30.0))
        for seed in (1, 1, 2)
    ]
    first, same, other = (motion for motion in motions if motion is not None)
    np.testing.assert_array_equal(first.position, same.position)
    assert first.position.shape != other.position.shape or not np.array_equal(first.position, other.position)


def test_a_redundant_arm_moves_its_elbow_under_a_fixed_tip() -> None:
    start = np.array(PANDA.robot.descriptor.home)
    held = ConstraintManifold.of(PANDA, STILL, start)
    goal = held.projected(start + [0.5, 0.0, -0.5, 0.0, 0.0, 0.0, 0.0])
    assert goal is not None
    assert np.abs(goal[0] - start).max() > 0.2
    motion = plan_held(World((), 0.0), held, start, goal, Limits.of(PANDA.robot), seed=0, deadline=Deadline(30.0))
    assert motion is not None
    assert_kept(PANDA, STILL, motion)


def test_a_sliding_and_turning_arm_keeps_its_height(tmp_path: Path) -> None:
    arm = RobotModel.of(small_arm(tmp_path))
    start = np.array([-3.0, 1.2, 0.3, 0.1])
    held = ConstraintManifold.of(arm, LEVEL, start)
    goals = held.projected(np.array([6.0, 0.9, 0.9, 0.15]))
    assert goals is not None
    motion = plan_held(World((), 0.0), held, start, goals, Limits.of(arm.robot), seed=0, deadline=Deadline(30.0))
    assert motion is not None
    np.testing.assert_array_equal(motion.position[-1], goals[0])
    assert_kept(arm, LEVEL, motion)


def test_a_goal_within_tolerance_of_the_constraint_is_exact() -> None:
    start = np.array(PANDA.robot.descriptor.home)
    pose = PANDA.fk_tip(start)
    held = ConstraintManifold.of(PANDA, LEVEL, start)
    pose[:3, 3] += (0.1, 0.2, 0.9 * LEVEL.position_tolerance)
    assert held.broken_at(pose) is None
    goals = solve_ik(PANDA, pose, start, world=None, max_solutions=4, seed=0, deadline=Deadline(30.0)).solutions
    motion = plan_held(World((), 0.0), held, start, goals, Limits.of(PANDA.robot), seed=0, deadline=Deadline(30.0))
    assert motion is not None
    assert np.abs(goals - motion.position[-1]).max(axis=1).min() == 0.0
    assert_kept(PANDA, LEVEL, motion)


def test_no_distance_at_all_gives_a_motion_that_stands_still() -> None:
    start = np.array(MODELS["ur5e"].robot.descriptor.home)
    held = ConstraintManifold.of(MODELS["ur5e"], STILL, start)
    motion = plan_held(
        World((), 0.0), held, start, start[None], Limits.of(held.model.robot), seed=0, deadline=Deadline(30.0)
    )
    assert motion is not None
    assert np.all(motion.position == start)


@examples(0.5)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 1e-9, 1e-4, 1.0, 3.0, np.pi - 1e-7, np.pi]))
def test_deviation_is_in_the_axes_of_the_frame(seed: int, angle: float) -> None:
    rng = np.random.default_rng(seed)
    q, pose = rng.uniform(PANDA.lower, PANDA.upper), np.eye(4)
    start = PANDA.fk_tip(q)
    axis = rng.normal(size=3)
    turn, shift = angle * axis / np.linalg.norm(axis), rng.normal(size=3)
    pose[:3, :3], pose[:3, 3] = rotation(turn) @ start[:3, :3], start[:3, 3] + shift
    for frame, axes in (("base", np.eye(3)), ("tool", start[:3, :3].T)):
        held = ConstraintManifold.of(PANDA, STILL.model_copy(update={"frame": frame}), q)
        found = held.deviations(pose)[0]
        vector = axes @ turn
        if angle > 3.14 and found[:3] @ vector < 0.0:  # half a turn is the same in either sense
            vector = -vector
        np.testing.assert_allclose(found[:3], vector, atol=1e-6)
        np.testing.assert_allclose(found[3:], axes @ shift, atol=1e-12)


@examples(0.4)
@given(st.sampled_from(sorted(MODELS)), st.sampled_from(KINDS), st.integers(0, 2**32 - 1))
def test_projection_keeps_the_constraint_within_limits(name: str, message: PathConstraint, seed: int) -> None:
    model, rng = MODELS[name], np.random.default_rng(seed)
    start, q = rng.uniform(model.lower, model.upper, (2, model.dof))
    held = ConstraintManifold.of(model, message, start)
    near = held.projected(q)
    if near is not None:
        assert used(model, message, start, near[0]) <= CLOSE / 0.0005 + 1e-4
        assert np.all((near >= model.lower) & (near <= model.upper))
    again = held.projected(start)
    assert again is not None
    np.testing.assert_array_equal(again[0], start)


@pytest.mark.parametrize(
    ("message", "shift", "turn", "says"),
    [
        (LEVEL, (0.1, 0.0, 0.012), (0.0, 0.0, 0.0), r"z would be off by 12\.00 mm \(5\.00 mm allowed\)"),
        (UPRIGHT, (0.1, 0.0, 0.0), (0.0, 0.1, 0.3), r"base frame, theta_y would be off by 5\.\d\d deg \(1\.15 deg"),
        (LINE, (0.0, 0.0, 0.1), (0.0, 0.0, 0.0), r"tool frame, z would be off by 100\.00 mm"),
    ],
)
def test_a_goal_off_the_constraint_names_the_component(
    message: PathConstraint, shift: tuple[float, float, float], turn: tuple[float, float, float], says: str
) -> None:
    home = np.array(PANDA.robot.descriptor.home)
    start = PANDA.fk_tip(home)
    goal = start.copy()
    goal[:3, 3] += start[:3, :3] @ shift if message is LINE else shift
    goal[:3, :3] = rotation(np.array(turn)) @ start[:3, :3]
    lost = ConstraintManifold.of(PANDA, message, home).broken_at(goal)
    assert lost is not None
    assert re.search(says, lost)


def test_a_violation_names_the_worst_row_and_what_is_lost_there(sides: tuple[Array, Array]) -> None:
    start, goal = sides
    held = ConstraintManifold.of(PANDA, LEVEL, start)
    low = start + [0.0, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0]
    violation = held.violation(np.array((start, low, goal)))
    assert violation is not None
    assert violation[0] == 1
    assert "z would be off by" in violation[1]
    assert held.use(np.array((start, low)))[1] > 1.0


def test_a_constrained_search_ends_by_samples_or_cancel() -> None:
    ur5e = MODELS["ur5e"]
    start = np.array(ur5e.robot.descriptor.home)
    held = ConstraintManifold.of(ur5e, STILL, start)
    found = solve_ik(
        ur5e, ur5e.fk_tip(start), start, world=None, max_solutions=8, seed=0, deadline=Deadline(30.0)
    ).solutions
    others = found[
        np.abs(found - start).max(axis=1) > 0.1
    ]  # an arm of six joints cannot get there without moving its tip
    assert len(others)
    world, limits = World((), 0.0), Limits.of(ur5e.robot)
    assert plan_held(world, held, start, others, limits, seed=0, deadline=Deadline(30.0), most=50) is None
    stop = Deadline(60.0)
    canceller = threading.Timer(0.1, stop.cancel)
    canceller.start()
    assert plan_held(world, held, start, others, limits, seed=0, deadline=stop) is None
    canceller.join()
    assert stop.cancelled
