"""What the local controller promises: whatever it is asked for, it stays inside the limits and away from what there is."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.examples import examples
from support.tiers import sampled
from zarm_contract.messages import Cuboid, PoseTolerance, SceneObject, Sphere
from zarm_contract.robot import load_robot
from zarm_geometry.exact import ExactScene
from zarm_geometry.motion_check import MotionCheck
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_servo.kernels.step import PERIOD
from zarm_servo.tracking.controller import STALE, Controller, Step
from zarm_servo.tracking.targets import JointSpeedTarget, JointTarget, PoseTarget, Target, TwistTarget
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits

MARGIN = 0.01
PRECISION = 1e-4
MODEL = RobotModel.of(load_robot("doosan_m1013"))
LIMITS = Limits.of(MODEL.robot)
START = np.array(MODEL.robot.descriptor.home) + (0.1, 0.1, -0.1, 0.05, 0.1, 0.0)
TIP = MODEL.fk_tip(START)


class Session:
    """A controller and what it has commanded."""

    def __init__(
        self, *objects: SceneObject, start: Array = START, margin: float = MARGIN, model: RobotModel = MODEL
    ) -> None:
        self.world, self.margin, self.model = World(objects, 0.0), margin, model
        self.limits = Limits.of(model.robot)
        check = MotionCheck(model)
        check.set_world(self.world)
        self.controller = Controller(model, check, self.limits, start, margin=margin)
        self.steps: list[Step] = []
        self.states = [self.controller.state]

    def follow(self, target: Target | None, seconds: float, age: float = 0.0) -> Step:
        for _ in range(round(seconds / PERIOD)):
            self.steps.append(self.controller.step(target, age))
            self.states.append(self.steps[-1].state)
        return self.steps[-1]

    def assert_sound(self) -> None:
        """Inside every limit, and never nearer than the margin by an exact check of each commanded configuration."""
        position, velocity, acceleration = np.swapaxes(self.states, 0, 1)
        assert np.all((position >= self.limits.lower) & (position <= self.limits.upper))
        assert np.all(np.abs(velocity) <= self.limits.velocity * (1 + 1e-6))
        assert np.all(np.abs(acceleration) <= self.limits.acceleration * (1 + 1e-6))
        assert np.all(np.abs(np.diff(acceleration, axis=0)) <= self.limits.jerk * PERIOD * (1 + 1e-6))
        # Between two of them the tip moves by less than 7 mm.
        scene, margin = ExactScene(self.model, self.world), self.margin - PRECISION
        assert not scene.too_near(position, 0.0, margin, margin)
        assert scene.nearest(position).distance > 0.0


def moved(x: float, y: float, z: float, turn: float = 0.0) -> Array:
    """The pose of the tip at START, moved (m) and turned about z (rad)."""
    pose = TIP.copy()
    pose[:3, 3] += x, y, z
    spin = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    pose[:3, :3] = spin @ pose[:3, :3]
    return pose


def wall(distance: float) -> Cuboid:
    """A wall across x, so far in front of the tip at START."""
    x = float(TIP[0, 3]) + distance + 0.05
    return Cuboid(kind="cuboid", name="wall", position=(x, 0.0, 0.5), size=(0.1, 4.0, 3.0))


@pytest.mark.lengthy
@pytest.mark.parametrize("shift", sampled((0.05, 0.08, -0.05, 0.3), ((0.0, 0.0, 0.0, 0.5),)))
def test_a_reachable_pose_is_reached_to_1_mm_and_0_01_rad(shift: tuple[float, ...]) -> None:
    session, pose = Session(), moved(*shift)
    step = session.follow(PoseTarget(pose), 4.0)
    tip = MODEL.fk_tip(step.state[0])
    assert np.linalg.norm(tip[:3, 3] - pose[:3, 3]) < 0.001
    assert np.linalg.norm(tip[:3, :3] - pose[:3, :3]) < 0.01
    assert np.abs(step.state[1]).max() < 0.001
    session.assert_sound()


@pytest.mark.parametrize("frame", ["base", "tool"])
def test_jog_starts_moves_and_stops_on_a_line(frame: Literal["base", "tool"]) -> None:
    session, asked = Session(), np.array([0.0, 0.2, 0.05, 0.0, 0.0, 0.0])
    session.follow(TwistTarget(asked, frame), 0.8)
    session.follow(TwistTarget(-asked, frame), 0.8)
    session.follow(TwistTarget(np.zeros(6), frame), 0.4)
    along = TwistTarget(asked, frame).in_base(TIP)[:3] / np.linalg.norm(asked)
    tips = MODEL.fk_tip(np.array(session.states)[:, 0])
    off = tips[:, :3, 3] - TIP[:3, 3]
    assert (off @ along).max() > 0.08
    assert np.linalg.norm(off - np.outer(off @ along, along), axis=1).max() < 5e-4
    assert np.abs(tips[:, :3, :3] - TIP[:3, :3]).max() < 1e-3
    assert np.abs(session.steps[-1].state[1]).max() < 1e-3
    session.assert_sound()


@pytest.mark.lengthy
def test_joints_are_reached_in_line_and_joint_speeds_are_kept() -> None:
    session = Session()
    goal = START + (0.3, -0.2, 0.1, 0.2, -0.3, 0.5)
    assert session.follow(JointTarget(goal), 4.0).state[0] == pytest.approx(goal, abs=1e-3)
    speeds = np.array([0.1, -0.05, 0.0, 0.0, 0.05, -0.2])
    assert session.follow(JointSpeedTarget(speeds), 0.8).state[1] == pytest.approx(speeds, abs=1e-6)
    session.assert_sound()


def test_a_margin_that_links_never_keep_does_not_slow_it() -> None:
    session = Session(wall(0.4), margin=0.06)
    speeds = np.array([0.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    step = session.follow(JointSpeedTarget(speeds), 0.6)
    assert step.state[1] == pytest.approx(speeds, abs=1e-6)
    assert step.limitation.kind == "free"
    session.assert_sound()


@pytest.mark.parametrize("beyond", [1e-13, 0.02])
def test_a_joint_beyond_its_limit_comes_back_alone(beyond: float) -> None:
    start = START.copy()
    start[3] = LIMITS.upper[3] + beyond
    outwards, inwards = Session(start=start), Session(start=start)
    outwards.follow(JointSpeedTarget(np.array([0.3, 0.0, 0.0, 0.3, 0.0, 0.0])), 1.0)
    commanded = np.array(outwards.states)[:, 0]
    assert commanded[-1, 0] > start[0] + 0.2, "another joint moves"
    assert commanded[:, 3].max() <= start[3] + 1e-9, "it does not go on"
    inwards.follow(JointSpeedTarget(np.array([0.0, 0.0, 0.0, -0.3, 0.0, 0.0])), 1.0)
    assert inwards.states[-1][0, 3] < LIMITS.upper[3] - 0.2


def test_a_target_that_is_stale_brakes_to_rest_and_is_named() -> None:
    session = Session()
    session.follow(TwistTarget(np.array([0.0, 0.1, 0.0, 0.0, 0.0, 0.0])), 0.5)
    step = session.follow(TwistTarget(np.array([0.0, 0.1, 0.0, 0.0, 0.0, 0.0])), 1.0, age=STALE + 0.01)
    assert step.limitation.kind == "target_stale"
    assert np.abs(step.state[1]).max() < 1e-9
    session.assert_sound()


@pytest.mark.lengthy
def test_along_a_wall_it_slides_and_says_what_slows_it() -> None:
    session = Session(wall(0.15))
    step = session.follow(TwistTarget(np.array([0.15, 0.1, 0.0, 0.0, 0.0, 0.0])), 2.5)
    assert step.limitation.kind == "slowing"
    assert step.limitation.pair is not None
    assert step.limitation.pair[1] == "wall"
    before, after = (MODEL.fk_tip(session.states[k][0])[:3, 3] for k in (-250, -1))
    assert after[1] - before[1] > 0.05
    session.assert_sound()


@pytest.mark.slow  # near to the next
@pytest.mark.lengthy
def test_at_the_margin_strong_joints_still_move_along_a_wall() -> None:
    model = RobotModel.of(load_robot("panda"))
    start = np.array((0.54, -1.06, -0.94, -3.06, 2.39, 0.71, 2.4))
    along = start + (-0.004, -0.062, -0.014, 0.004, -0.1, 0.057, -0.011)
    wall = Cuboid(kind="cuboid", name="wall", position=(2.05, 0.0, 0.0), size=(0.1, 4.0, 4.0))
    check = MotionCheck(model)
    check.set_world(World([wall], 0.0))
    away = min(pair.distance for pair in check.nearby(start, within=3.0) if pair.object == "wall")
    near = wall.model_copy(update={"position": (2.05 - (away - MARGIN - 0.0007), 0.0, 0.0)})
    session = Session(near, start=start, model=model)
    session.follow(JointTarget(along), 1.0)
    np.testing.assert_allclose(session.states[-1][0], along, atol=1e-3)
    session.assert_sound()


def test_a_pose_inside_an_obstacle_brings_it_near_and_no_nearer() -> None:
    session = Session(wall(0.15))
    session.follow(PoseTarget(moved(0.3, 0.0, 0.0)), 3.0)
    session.assert_sound()
    assert ExactScene(MODEL, session.world).nearest(session.states[-1][0]).distance < MARGIN + 0.03
    back = session.follow(PoseTarget(TIP), 3.0)
    assert MODEL.fk_tip(back.state[0])[:3, 3] == pytest.approx(TIP[:3, 3], abs=0.002)
    session.assert_sound()


@pytest.mark.lengthy
def test_a_pose_that_just_keeps_the_margin_is_reached() -> None:
    pose = moved(0.08, 0.05, 0.0)
    free = Session(wall(1.0))
    there = free.follow(PoseTarget(pose), 4.0).state[0]
    away = ExactScene(MODEL, free.world).nearest(there[None], itself=False).distance
    session = Session(wall(1.0 - away + MARGIN + 0.0005))
    step = session.follow(PoseTarget(pose), 6.0)
    assert np.linalg.norm(MODEL.fk_tip(step.state[0])[:3, 3] - pose[:3, 3]) < 0.0005
    session.assert_sound()


@pytest.mark.lengthy
def test_a_robot_in_an_obstacle_leaves_it_monotonically() -> None:
    session = Session(wall(-0.03))
    scene = ExactScene(MODEL, session.world)
    step = session.follow(TwistTarget(np.array([0.1, 0.1, 0.0, 0.0, 0.0, 0.0])), 0.5)
    assert step.limitation.pair is not None
    assert step.limitation.pair[1] == "wall"
    session.follow(TwistTarget(np.array([-0.1, 0.0, 0.0, 0.0, 0.0, 0.0])), 4.0)
    distances = np.array([scene.nearest(state[0], itself=False).distance for state in session.states[::10]])
    assert distances[0] < -0.02
    assert distances[-1] > MARGIN
    assert np.diff(np.minimum(distances, MARGIN)).min() > -PRECISION


@pytest.mark.lengthy
def test_the_elbow_is_stretched_slowly() -> None:
    session = Session()
    session.follow(PoseTarget(moved(1.5, 0.0, 0.3)), 6.0)
    singular = [np.linalg.svd(MODEL.tip_jacobian(state[0]), compute_uv=False)[-1] for state in session.states[::5]]
    speeds = np.abs([state[1] for state in session.states[::5]]).max(axis=1)
    assert min(singular) < 0.02
    assert speeds[np.array(singular) < 0.02].max() < 0.3 * LIMITS.velocity.max()
    session.assert_sound()


def a_target(rng: np.random.Generator) -> Target | None:
    kind = rng.integers(6)
    if kind == 0:
        return None
    if kind == 1:
        return JointSpeedTarget(rng.normal(0.0, 1.0, MODEL.dof))
    if kind == 2:
        return JointTarget(rng.uniform(LIMITS.lower, LIMITS.upper))
    if kind == 3:
        return TwistTarget(rng.normal(0.0, 0.5, 6), rng.choice(["base", "tool"]))
    if kind == 4:
        return PoseTarget(moved(*rng.normal(0.0, 3.0, 4)))
    return PoseTarget(moved(*rng.normal(0.0, 0.2, 4)), rng.normal(0.0, 0.2, 6))


@pytest.mark.lengthy
@examples(0.4)
@given(seed=st.integers(0, 2**32 - 1))
def test_limits_and_margin_hold_for_jumping_targets(seed: int) -> None:
    rng = np.random.default_rng(seed)
    objects = []
    for i in range(rng.integers(0, 10)):
        place = TIP[:3, 3] + rng.normal(0.0, 0.35, 3)
        ball = Sphere(kind="sphere", name=f"ball{i}", position=tuple(place.tolist()), radius=rng.uniform(0.01, 0.1))
        if ExactScene(MODEL, World([ball], 0.0)).nearest(START).distance > 2 * MARGIN:
            objects.append(ball)
    session = Session(*objects)
    for _ in range(5):
        session.follow(a_target(rng), float(rng.choice([0.02, 0.1, 0.4])))
    session.follow(None, 1.3)
    session.assert_sound()
    assert np.abs(session.states[-1][1]).max() < 1e-9


# -- targets with freedom --


def test_only_what_is_not_free_is_corrected() -> None:
    """A target with a free turn is reached without that turn, and one whose position alone counts without any."""
    turned = TIP.copy()
    angle = 0.6
    turn = np.array(((np.cos(angle), -np.sin(angle), 0.0), (np.sin(angle), np.cos(angle), 0.0), (0.0, 0.0, 1.0)))
    turned[:3, :3] = TIP[:3, :3] @ turn
    turned[:3, 3] += (0.0, 0.05, 0.0)
    for tolerance in (
        PoseTolerance(orientation=(0.0, 0.0, "free")),
        PoseTolerance(orientation=("free", "free", "free")),
    ):
        session = Session()
        step = session.follow(PoseTarget(turned, tolerance=tolerance), 3.0)
        tip = MODEL.fk_tip(step.state[0])
        assert tip[:3, 3] == pytest.approx(turned[:3, 3], abs=1e-3)
        assert tip[:3, 2] == pytest.approx(TIP[:3, 2], abs=0.2)
        session.assert_sound()
    free, held = Session(), Session()
    free.follow(PoseTarget(turned, tolerance=PoseTolerance(orientation=(0.0, 0.0, "free"))), 3.0)
    held.follow(PoseTarget(turned), 3.0)
    assert abs(held.states[-1][0][5] - START[5]) > 3 * abs(free.states[-1][0][5] - START[5])


def test_tip_that_is_within_the_tolerance_stays_where_it_is() -> None:
    aside = TIP.copy()
    aside[:3, 3] += (0.0, 0.02, 0.0)
    session = Session()
    ball = PoseTolerance(orientation=("free", "free", "free"), radius=0.03)
    session.follow(PoseTarget(aside, tolerance=ball), 1.0)
    assert session.states[-1][0] == pytest.approx(START, abs=1e-6)
    aside[:3, 3] += (0.0, 0.05, 0.0)
    session.follow(PoseTarget(aside, tolerance=ball), 3.0)
    tip = MODEL.fk_tip(session.states[-1][0])
    assert np.linalg.norm(tip[:3, 3] - aside[:3, 3]) == pytest.approx(0.03, abs=2e-3)
