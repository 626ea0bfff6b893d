"""Plans keep the torques of the joints with what is carried, or say that they do not know them."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio
import pytest

from zarm_contract.descriptor import StatedJointDynamics
from zarm_contract.errors import InvalidRequest, PlanningFailed
from zarm_contract.messages import (
    AddObjects,
    Attach,
    AttachObject,
    CheckRequest,
    Cuboid,
    InverseDynamicsRequest,
    JointGoal,
    LineGoal,
    Move,
    Plan,
    PlanRequest,
    ProgramRequest,
    SceneEdit,
)
from zarm_contract.robot import ROBOTS, load_robot
from zarm_geometry.dynamics import Dynamics, JointDynamics, Weight, weights_of
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.deadline import Deadline
from zarm_planner.handlers import Handlers
from zarm_planner.scene.store import SceneStore
from zarm_planner.timing.sampling import TOLERANCE, load
from zarm_planner.timing.smoothing import smooth_path
from zarm_planner.timing.torque import TooFast, TooHeavy, within_torque
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

PANDA = load_robot("panda")
MODEL = RobotModel.of(PANDA)
HOME = np.array(PANDA.descriptor.home)
THERE = (1.4, 0.5, 0.3, -1.4, 0.2, 2.2, 0.3)
SIDE = 0.06


def planner(folder: Path, robot: RobotModel = MODEL) -> Handlers:
    home = np.array(robot.robot.descriptor.home)
    return Handlers(robot, robot.robot.descriptor.name, SceneStore(folder), lambda: home)


def block_at_the_tip() -> Cuboid:
    tip = MODEL.fk_tip(HOME)[:3, 3]
    return Cuboid(kind="cuboid", name="block", position=tuple((tip - [0.0, 0.0, 0.05]).tolist()), size=(SIDE,) * 3)


def with_load(folder: Path, mass: float | None) -> Handlers:
    handlers = planner(folder)
    handlers.edit(SceneEdit(edit=AddObjects(op="add", objects=(block_at_the_tip(),))))
    touch = ("panda_hand", "panda_leftfinger", "panda_rightfinger")
    handlers.edit(SceneEdit(edit=AttachObject(op="attach", name="block", touch_links=touch, mass=mass)))
    return handlers


def to_there(handlers: Handlers, **options: object) -> Plan:
    return handlers.plan(PlanRequest(goal=JointGoal(kind="joints", position=THERE), optimize_s=0.0, **options))


def inverse(mass: float, states: Array) -> Array:
    """The torques (n, 7) of states (3, n, 7) of the Panda with a `mass` (kg) at its flange, by Pinocchio, which reads the URDF by itself."""
    model = pinocchio.buildModelFromUrdf(str(ROBOTS / "panda.urdf"))
    flange = model.frames[model.getFrameId(PANDA.descriptor.tip_link)]
    load = pinocchio.Inertia(mass, np.zeros(3), mass * SIDE**2 / 6 * np.eye(3))
    below = pinocchio.SE3(np.eye(3), np.array([0.0, 0.0, 0.05]))
    model.appendBodyToJoint(flange.parentJoint, load, flange.placement * below)
    data, fingers, still = model.createData(), np.full(2, 0.04), np.zeros(2)
    return np.array(
        [
            pinocchio.rnea(model, data, np.append(q, fingers), np.append(v, still), np.append(a, still))[:7]
            for q, v, a in states.transpose(1, 0, 2)
        ]
    )


def worst(plan: Plan, mass: float) -> float:
    """The largest share of an effort that Pinocchio gives, every millisecond."""
    trajectory = TimedTrajectory.of(plan.trajectory, PANDA.descriptor.joints)
    efforts = {joint.name: joint.effort for joint in PANDA.urdf.joint_of_child.values()}
    limit = np.array([efforts[name] for name in PANDA.descriptor.joints], float)
    return float((np.abs(inverse(mass, trajectory.sample(np.arange(0.0, trajectory.duration, 0.001)))) / limit).max())


def test_a_light_robot_is_not_slowed_and_reports_its_torque(tmp_path: Path) -> None:
    plan = to_there(planner(tmp_path))
    assert plan.torque is not None
    assert plan.torque.stretch == 1.0
    assert plan.torque.share == pytest.approx(worst(plan, 1e-9), abs=1e-3)
    assert plan.torque.time <= plan.trajectory.time[-1]


@pytest.mark.parametrize("mass", [5.0, 6.0])
def test_what_is_heavy_is_carried_more_slowly_within_the_efforts(mass: float, tmp_path: Path) -> None:
    light, heavy = to_there(with_load(tmp_path / "light", None)), to_there(with_load(tmp_path / "heavy", mass))
    assert worst(light, mass) > 1.0, "as fast as without a load it would need more than there is"
    assert worst(heavy, mass) <= 1.0
    assert heavy.torque is not None
    assert heavy.torque.share == pytest.approx(worst(heavy, mass), abs=2e-3)
    assert heavy.torque.stretch > 1.0
    assert heavy.trajectory.time[-1] > light.trajectory.time[-1]


def test_what_is_too_heavy_to_hold_is_refused_with_the_joint(tmp_path: Path) -> None:
    handlers = with_load(tmp_path, 30.0)
    with pytest.raises(
        PlanningFailed, match=r"panda_joint\d would need \d+ Nm at .*, however slow it is, and has \d+: .*; carry less"
    ):
        to_there(handlers, max_attempts=2)


def between(robot: RobotModel, seed: int) -> tuple[TimedTrajectory, Limits]:
    """A fast motion through three random configurations."""
    limits = Limits.of(robot.robot)
    ends = np.random.default_rng(seed).uniform(
        np.maximum(robot.lower, -2.5), np.minimum(robot.upper, 2.5), (3, robot.dof)
    )
    deadline = Deadline(math.inf)
    return smooth_path(robot, World((), 0.0), ends, limits, 0.01, seed=seed, deadline=deadline), limits


def loaded(robot: RobotModel, mass: float) -> Dynamics:
    """A robot that carries a `mass` (kg) at its last joint."""
    assert robot.dynamics is not None
    weights = weights_of(robot.robot)
    assert weights is not None
    load = Weight(robot.dof - 1, mass, np.array([0.0, 0.0, 0.1]), 1e-3 * mass * np.eye(3))
    return Dynamics.of(robot.tree, (*weights, load), robot.dynamics.limit)


def as_a_whole(dynamics: Dynamics, motion: TimedTrajectory) -> float:
    """How much slower the whole of a motion must be to keep the efforts."""
    states = motion.sample(np.arange(0.0, motion.duration, 0.001))
    holding = dynamics.holding(states[0])
    moving = dynamics.torque(*states) - holding
    return float(np.sqrt(np.abs(moving) / (dynamics.limit - np.sign(moving) * holding)).max())


JOINTS = StatedJointDynamics(
    friction=(6.0, 6.0, 5.0, 5.0, 1.0, 1.0, 0.8), damping=(3.0, 3.0, 2.0, 2.0, 0.4, 0.4, 0.3), armature=(0.3,) * 7
)
"""Joints of a Panda that lose a tenth of their efforts."""


def stiff_panda() -> RobotModel:
    """The Panda, its descriptor with the dynamics of its joints."""
    execution = PANDA.descriptor.execution.model_copy(update={"joint_dynamics": JOINTS})
    return RobotModel.of(replace(PANDA, descriptor=PANDA.descriptor.model_copy(update={"execution": execution})))


def test_friction_damping_and_armature_count_as_torque() -> None:
    dynamics = stiff_panda().dynamics
    assert dynamics is not None
    for seed in range(40):
        motion, limits = between(MODEL, seed)
        slower, use = within_torque(dynamics, motion, limits)
        states = slower.sample(np.arange(0.0, slower.duration, 0.001))
        of_joints = np.array(JOINTS.friction) * np.sign(states[1]) + JOINTS.damping * states[1]
        needed = inverse(1e-9, states) + of_joints + JOINTS.armature * states[2]
        share = float((np.abs(needed) / dynamics.limit).max())
        assert share <= 1.0
        assert use.share == pytest.approx(share, abs=5e-3)


def test_what_friction_holds_fast_is_refused() -> None:
    joints = JOINTS.model_copy(update={"friction": (90.0, *JOINTS.friction[1:])})
    stuck = replace(loaded(MODEL, 1.0), joints=JointDynamics.of(joints))
    motion, limits = between(MODEL, 0)
    with pytest.raises(TooHeavy, match=r"would need \d+ Nm at .* however slow it is, and has 87"):
        within_torque(stuck, motion, limits)


@pytest.mark.parametrize(("name", "mass"), [("panda", 3.0), ("ur5e", 6.0), ("ur10e", 12.5)])
def test_a_motion_is_slowed_only_where_torque_needs_it(name: str, mass: float) -> None:
    robot = RobotModel.of(load_robot(name))
    dynamics, ratios = loaded(robot, mass), []
    for seed in range(40):
        motion, limits = between(robot, seed)
        slower, use = within_torque(dynamics, motion, limits)
        states = slower.sample(np.arange(0.0, slower.duration, 0.001))
        assert (np.abs(dynamics.torque(*states)) <= dynamics.limit).all()
        assert use.share <= 1.0
        assert load(slower, limits) <= 1.0 + 2 * TOLERANCE
        np.testing.assert_array_equal(slower.states[:, [0, -1]], motion.states[:, [0, -1]])
        if slower is not motion:
            ratios.append((slower.duration / motion.duration, as_a_whole(dynamics, motion)))
    ours, whole = np.array(ratios).T
    assert (ours <= 1.01 * np.maximum(whole, 1.0)).all()  # which takes all of the efforts
    assert (ours - 1.0).mean() < 0.5 * (whole - 1.0).mean()


def test_a_motion_that_is_slowed_down_keeps_its_path() -> None:
    dynamics = loaded(MODEL, 3.0)
    motion, limits = next(
        each for each in (between(MODEL, seed) for seed in range(40)) if as_a_whole(dynamics, each[0]) > 1.1
    )
    slower, _ = within_torque(dynamics, motion, limits)
    path = motion.positions(np.arange(0.0, motion.duration, 0.0005))
    for position in slower.positions(np.arange(0.0, slower.duration, 0.01)):
        assert np.abs(path - position).max(axis=1).min() < 2e-3


def test_a_motion_that_has_begun_begins_as_it_did_or_is_refused() -> None:
    dynamics, kept, refused = loaded(MODEL, 3.0), 0, 0
    for seed in range(60):
        whole, limits = between(MODEL, seed)
        motion = whole.since(0.3 * whole.duration)
        motion = motion.begun_at(-motion.begin)
        try:
            slower, _ = within_torque(dynamics, motion, limits, begun=True)
        except TooFast:
            refused += 1
            continue
        np.testing.assert_allclose(slower.states[:, 0], motion.states[:, 0], rtol=0.0, atol=1e-9)
        states = slower.sample(np.arange(0.0, slower.duration, 0.001))
        assert (np.abs(dynamics.torque(*states)) <= dynamics.limit).all()
        kept += slower is not motion
    assert kept > 0
    assert refused > 0


def test_a_heavy_load_follows_a_straight_line(tmp_path: Path) -> None:
    x, y, z = MODEL.fk_tip(HOME)[:3, 3]
    line = LineGoal(kind="line", position=(x, y + 0.3, z - 0.1), speed=1.5, acceleration=8.0)
    light, heavy = (
        with_load(tmp_path / str(mass), mass).plan(PlanRequest(goal=line, optimize_s=0.0)) for mass in (None, 9.0)
    )
    assert heavy.tool is not None
    assert worst(light, 9.0) > 1.0
    assert worst(heavy, 9.0) <= 1.0


def test_a_motion_that_was_slowed_down_is_not_sped_up_again(tmp_path: Path) -> None:
    handlers = with_load(tmp_path, 5.0)
    plan = handlers.plan(PlanRequest(goal=JointGoal(kind="joints", position=THERE), optimize_s=0.1))
    assert worst(plan, 5.0) <= 1.0


def test_a_check_says_what_holds_each_joint(tmp_path: Path) -> None:
    """Against the weight of the load at its distance from each axis."""
    light, heavy = (
        with_load(tmp_path / str(mass), mass)
        .check(CheckRequest(joints=(tuple(HOME.tolist()),), torque=True))
        .results[0]
        for mass in (1e-9, 2.0)
    )
    assert light.holding is not None
    assert heavy.holding is not None
    below = MODEL.fk_tip(HOME)[:3, 3] - [0.0, 0.0, 0.05]
    for joint, (one, other) in enumerate(zip(light.holding, heavy.holding, strict=True)):
        frame = MODEL.fk_joint(joint, HOME)
        lever = np.cross(frame[:3, 2], below - frame[:3, 3])[2]
        assert other.torque - one.torque == pytest.approx(2.0 * 9.81 * lever, abs=1e-4)
        assert other.effort in (87.0, 12.0)
    assert (
        with_load(tmp_path / "none", 2.0).check(CheckRequest(joints=(tuple(HOME.tolist()),))).results[0].holding is None
    )


def test_a_program_keeps_the_torques_of_each_segment(tmp_path: Path) -> None:
    handlers = planner(tmp_path)
    handlers.edit(SceneEdit(edit=AddObjects(op="add", objects=(block_at_the_tip(),))))
    touch = ("panda_hand", "panda_leftfinger", "panda_rightfinger")
    attach = Attach(kind="attach", object="block", touch_links=touch, mass=5.0)
    there, back = (Move(kind="move", goal=JointGoal(kind="joints", position=q)) for q in (THERE, tuple(HOME.tolist())))
    plan, _ = handlers.program(ProgramRequest(segments=(attach, there, back)))
    assert plan.torque is not None
    assert plan.torque.stretch > 1.0
    assert worst(plan, 5.0) <= 1.0


def test_a_robot_of_unknown_inertia_says_nothing_of_torques(tmp_path: Path) -> None:
    m1013 = RobotModel.of(load_robot("doosan_m1013"))
    goal = JointGoal(kind="joints", position=(0.5, 0.2, 1.2, 0.0, 1.2, 0.0))
    plan = planner(tmp_path, m1013).plan(PlanRequest(goal=goal, optimize_s=0.0))
    assert plan.torque is None


def test_the_torques_of_a_motion_are_those_of_pinocchio(tmp_path: Path) -> None:
    states = np.random.default_rng(0).uniform(-1.0, 1.0, (3, 50, 7))
    states[0] += HOME
    states[2] *= 5.0
    joints, velocity, acceleration = (tuple(map(tuple, rows.tolist())) for rows in states)
    request = InverseDynamicsRequest(joints=joints, velocity=velocity, acceleration=acceleration)
    reply = with_load(tmp_path, 3.0).inverse_dynamics(request)
    assert reply.torque is not None
    np.testing.assert_allclose(reply.torque, inverse(3.0, states), atol=0.02)
    assert reply.effort == (87.0,) * 4 + (12.0,) * 3
    still = planner(tmp_path / "light").inverse_dynamics(InverseDynamicsRequest(joints=joints))
    np.testing.assert_allclose(
        still.torque or (), inverse(1e-9, np.stack((states[0], 0.0 * states[1], 0.0 * states[2]))), atol=0.02
    )


def test_unknown_torques_are_left_out(tmp_path: Path) -> None:
    m1013 = RobotModel.of(load_robot("doosan_m1013"))
    assert planner(tmp_path, m1013).inverse_dynamics(InverseDynamicsRequest(joints=((0.0,) * 6,))).torque is None
    with pytest.raises(InvalidRequest, match="6 values for the 7 joints"):
        planner(tmp_path / "panda").inverse_dynamics(InverseDynamicsRequest(joints=((0.0,) * 7, (0.0,) * 6)))
    with pytest.raises(ValueError, match="velocity"):
        InverseDynamicsRequest(joints=((0.0,) * 7,), velocity=((0.0,) * 7, (0.0,) * 7))
