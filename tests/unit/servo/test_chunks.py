"""What following chunks promises: the robot is where a chunk says when it says so, if the limits allow it, and never outside them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from support.examples import examples
from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Cuboid, JointPoints, Pose, PosePoints, SceneObject, ServoChunk
from zarm_contract.robot import load_robot
from zarm_geometry.exact import ExactScene
from zarm_geometry.frames import matrix
from zarm_geometry.motion_check import MotionCheck
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_servo.kernels.step import PERIOD
from zarm_servo.tracking import chunk_tracking
from zarm_servo.tracking.chunk_inbox import JUMP, ChunkInbox, Taken
from zarm_servo.tracking.chunk_tracking import ChunkTracking
from zarm_servo.tracking.controller import Controller, Limitation, Surroundings
from zarm_servo.tracking.grip_follower import GripFollower
from zarm_servo.tracking.session import soft
from zarm_servo.tracking.targets import JointTarget
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits

Motion = Callable[[float], Array]

MODEL = RobotModel.of(load_robot("ur5e"))
HOME = np.array(MODEL.robot.descriptor.home)
UNIX = 1.75e9
"""Unix time at 0 s of the monotonic clock."""
DT = 1 / 30
MARGIN = 0.01


class Follower:
    """A robot in a world, led by chunks."""

    def __init__(self, *objects: SceneObject, scale: float = 1.0) -> None:
        check = MotionCheck(MODEL)
        check.set_world(World(objects, 0.0))
        self.scene = ExactScene(MODEL, World(objects, 0.0))
        self.limits = soft(Limits.of(MODEL.robot, scale))
        self.controller = Controller(MODEL, check, self.limits, HOME, margin=MARGIN)
        nothing: Any = None
        self.tracking = ChunkTracking(
            MODEL, self.limits, self.controller, GripFollower(nothing, nothing, nothing), lambda: None
        )
        self.inbox: ChunkInbox = self.tracking._inbox
        self.time = 0.0
        self.states = [self.controller.state]
        self.limitation = Limitation("target_stale")

    def take(self, chunk: ServoChunk, late: float = 0.0) -> Taken:
        now = self.time + late
        return self.inbox.receive(chunk, now, UNIX + now, self.time, self.controller.state[0])

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / PERIOD)):
            self.time += PERIOD
            step = self.tracking.step(self.time, 1.0, Surroundings(), self.limitation)
            if step is None:
                step = self.controller.step(None, 0.0)
            self.limitation = step.limitation
            self.states.append(step.state)

    def stream(self, motion: Motion, seconds: float, *, every: float = DT, points: int = 50) -> Array:
        """Follow chunks of a motion; how far (N, J) the robot was from it."""
        begin = len(self.states)
        number = self.tracking.sequence
        for _ in range(round(seconds / every)):
            number += 1
            self.take(chunk(motion, self.time, points, sequence=number))
            self.run(every)
        times = PERIOD * np.arange(begin, len(self.states))
        return np.array([state[0] - motion(time) for state, time in zip(self.states[begin:], times, strict=True)])

    def assert_sound(self) -> None:
        """Inside every limit, the jerk between samples too, and never nearer than the margin to anything."""
        position, velocity, acceleration = np.swapaxes(self.states, 0, 1)
        assert np.all((position >= self.limits.lower) & (position <= self.limits.upper))
        assert np.all(np.abs(velocity) <= self.limits.velocity * (1 + 1e-3))
        assert np.all(np.abs(acceleration) <= self.limits.acceleration * (1 + 1e-6))
        assert np.all(np.abs(np.diff(acceleration, axis=0)) <= self.limits.jerk * PERIOD * (1 + 1e-6))
        assert not self.scene.too_near(position, 0.0, MARGIN - 1e-4, MARGIN - 1e-4)


def chunk(motion: Motion, made: float, points: int = 50, **fields: Any) -> ServoChunk:
    """What a policy plans at the time `made`."""
    return chunk_of(np.array([motion(made + k * DT) for k in range(points)]), made, **fields)


def chunk_of(rows: Array, made: float, **fields: Any) -> ServoChunk:
    """A chunk made at that time of these positions (N, J)."""
    points = JointPoints(kind="joints", position=tuple(map(tuple, rows.tolist())))
    return ServoChunk(**({"goal_id": "a", "sequence": 1, "stamp": UNIX + made, "dt": DT, "points": points} | fields))


def wave(frequency: float, size: float) -> Motion:
    """A joint that swings about HOME, and two that swing half as far."""
    share = size * np.array([1.0, 0.0, 0.5, 0.5, 0.0, 0.0])

    def motion(time: float) -> Array:
        u = min(time / 2.0, 1.0)
        return HOME + share * np.sin(2 * np.pi * frequency * time) * u**3 * (10.0 - 15.0 * u + 6.0 * u**2)

    return motion


@pytest.mark.parametrize(("every", "points"), [(DT, 50), (0.1, 16), (0.5, 50)])
def test_a_motion_within_the_limits_is_followed_without_lag(every: float, points: int) -> None:
    robot = Follower()
    off = robot.stream(wave(0.4, 0.4), 6.0, every=every, points=points)
    assert np.abs(off).max() < 5e-4
    robot.assert_sound()


def test_a_motion_of_the_tip_is_followed_too() -> None:
    robot = Follower()
    tip = MODEL.fk_tip(HOME)
    for number in range(1, 60):
        poses = []
        for k in range(20):
            x, y, z = (tip[:3, 3] + (0.0, 0.05 * np.sin(2.0 * (robot.time + k * DT)), 0.0)).tolist()
            poses.append(Pose(position=(x, y, z), orientation=_quaternion(tip)))
        points = PosePoints(kind="poses", pose=tuple(poses))
        robot.take(ServoChunk(goal_id="a", sequence=number, stamp=UNIX + robot.time, dt=DT, points=points))
        robot.run(DT)
    reached = MODEL.fk_tip(robot.controller.state[0])
    assert reached[1, 3] - tip[1, 3] == pytest.approx(0.05 * np.sin(2.0 * robot.time), abs=5e-4)
    assert np.abs(reached[[0, 2], 3] - tip[[0, 2], 3]).max() < 5e-4
    robot.assert_sound()


def _quaternion(pose: Array) -> tuple[float, float, float, float]:
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat().tolist()
    assert np.allclose(matrix((0.0, 0.0, 0.0), (x, y, z, w))[:3, :3], pose[:3, :3])
    return x, y, z, w


def test_noise_of_a_policy_is_not_followed() -> None:
    robot, rng, clean = Follower(), np.random.default_rng(0), wave(0.4, 0.4)
    for number in range(1, 150):
        robot.take(chunk(lambda time: clean(time) + 1e-3 * rng.normal(size=6), robot.time, sequence=number))
        robot.run(DT)
    off = [state[0] - clean(PERIOD * k) for k, state in enumerate(robot.states)]
    assert np.sqrt(np.mean(np.square(off))) < 1e-3
    robot.assert_sound()


def test_a_chunk_is_followed_until_the_next_without_a_jump() -> None:
    robot, first = Follower(), wave(0.3, 0.3)
    robot.stream(first, 3.0)
    begins = robot.time + 0.3
    rows = np.array([first(begins + k * DT) + 0.05 for k in range(50)])
    robot.take(chunk_of(rows, robot.time, sequence=1000, start=UNIX + begins))
    robot.run(0.3)
    assert np.abs(robot.controller.state[0] - first(robot.time)).max() < 1e-3
    robot.run(0.7)
    assert robot.controller.state[0] == pytest.approx(first(robot.time) + 0.05, abs=1e-3)
    robot.assert_sound()


def test_a_robot_that_is_found_elsewhere_goes_on_from_there() -> None:
    robot, motion = Follower(), wave(0.4, 0.3)
    robot.stream(motion, 3.01)
    elsewhere = robot.controller.state.copy()
    elsewhere[0] += 0.01
    elsewhere[2] *= 0.2
    robot.controller.restart(elsewhere)
    robot.states = [robot.controller.state]
    robot.run(0.5)
    assert robot.controller.state[0] == pytest.approx(motion(robot.time), abs=1e-3)
    robot.assert_sound()


@given(seed=st.integers(0, 2**32))
@examples(1)
def test_limits_and_margin_hold_for_any_chunk(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x = float(MODEL.fk_tip(HOME)[0, 3]) + rng.uniform(0.1, 0.3) * (1 if rng.random() < 0.5 else -1)
    robot = Follower(Cuboid(kind="cuboid", name="post", position=(x, 0.1, 0.4), size=(0.06, 0.06, 0.8)))
    if robot.scene.too_near(HOME[None], 0.0, MARGIN, MARGIN):
        return
    number = 0
    while robot.time < 4.0:
        number += 1
        here = robot.controller.state[0]
        steps = np.cumsum(rng.normal(0.0, rng.choice((0.003, 0.02, 0.1)), (int(rng.integers(2, 60)), 6)), axis=0)
        rows = here + rng.uniform(-0.4, 0.4, 6) + steps - steps[0]
        told = chunk_of(rows, robot.time, sequence=number, dt=float(rng.choice((0.01, DT, 0.1))))
        robot.take(told)
        robot.run(float(rng.choice((0.02, 0.1, 0.7))))
    robot.run(2.0)
    robot.assert_sound()


ODD = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False),
    st.sampled_from((0.0, 1e-9, 0.001, 1.0, -1.0, 1e3, -1e3, 1e9, 1e308)),
    st.floats(-1.0, 1.0),
)


@given(data=st.data())
@examples(10)
def test_odd_numbers_are_refused_or_followed_inside_the_limits(data: st.DataObject) -> None:
    count = data.draw(st.integers(2, 6))
    rows = HOME + np.array(data.draw(st.lists(st.floats(-0.4, 0.4), min_size=count, max_size=count)))[:, None]
    rows[data.draw(st.integers(0, count - 1)), 0] = data.draw(ODD)
    points = {"kind": "joints", "position": tuple(map(tuple, rows.tolist()))}
    if data.draw(st.booleans()):
        points["velocity"] = tuple((data.draw(ODD),) * 6 for _ in range(count))
    fields = {
        name: data.draw(ODD) for name in ("dt", "start", "expiry", "observed", "stamp") if data.draw(st.booleans())
    }
    robot = Follower()
    try:
        taken = robot.take(chunk_of(rows, 0.0, **({"points": JointPoints(**points)} | fields)))  # type: ignore[arg-type]
    except (InvalidRequest, ValidationError):
        return
    assert all(np.isfinite(over.excess) for over in taken.clipped)
    robot.run(0.3)
    assert np.isfinite(robot.states).all()
    robot.assert_sound()


def test_at_the_end_of_a_chunk_the_robot_brakes() -> None:
    robot = Follower()
    robot.take(chunk(lambda time: HOME + 0.3 * time, 0.0, 10, expiry=0.2))
    robot.run(0.2)
    assert robot.states[-1][1].max() > 0.1
    robot.run(1.0)
    assert robot.limitation.kind == "target_stale"
    assert np.abs(robot.states[-1][1]).max() < 1e-9
    robot.assert_sound()


def test_a_wall_stops_a_chunk_and_is_named() -> None:
    y = float(MODEL.fk_tip(HOME)[1, 3])
    wall = Cuboid(kind="cuboid", name="wall", position=(0.0, y + 0.19, 0.5), size=(3.0, 0.02, 2.0))
    robot = Follower(wall)

    def swing(time: float) -> Array:
        return HOME + 0.8 * np.sin(min(time, 6.0)) * np.array([1.0, 0, 0, 0, 0, 0])

    seen = set()
    for number in range(1, 210):
        robot.take(chunk(swing, robot.time, sequence=number))
        robot.run(DT)
        if robot.limitation.pair is not None:
            seen.add(robot.limitation.pair[1])
    assert "wall" in seen
    assert robot.controller.state[0] == pytest.approx(swing(robot.time), abs=1e-3)
    robot.assert_sound()


def test_what_the_limits_clip_is_named_with_its_joint_and_amount() -> None:
    robot = Follower()
    rows = HOME + 10.0 * DT * np.arange(50)[:, None] * np.array([0.0, 0, 1.0, 0, 0, 0])
    over = robot.take(chunk_of(rows, 0.0)).clipped
    named = {(each.joint, each.quantity): each.excess for each in over}
    joint = MODEL.robot.descriptor.joints[2]
    assert set(named) == {(joint, "velocity"), (joint, "position")}
    assert named[joint, "velocity"] == pytest.approx(10.0 - robot.limits.velocity[2])
    robot.run(2.0)
    robot.assert_sound()


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_joint_that_is_asked_to_be_too_fast_moves_at_its_limit(sign: float) -> None:
    robot = Follower()
    rows = HOME + sign * 4.0 * DT * np.arange(40)[:, None] * np.eye(6)[0]
    robot.take(chunk_of(rows, 0.0))
    robot.run(1.2)
    fastest = np.abs([state[1, 0] for state in robot.states]).max()
    assert fastest == pytest.approx(robot.limits.velocity[0], rel=0.01)
    robot.assert_sound()


def test_lost_and_late_chunks_are_reported_and_used() -> None:
    robot, motion = Follower(), wave(0.4, 0.3)
    robot.stream(motion, 3.0)
    number = robot.tracking.sequence
    told = chunk(motion, robot.time, sequence=number + 4)
    robot.run(0.5)
    taken = robot.take(told)
    assert taken.lost == 3
    assert taken.late == pytest.approx(0.5)
    assert taken.jump < 1e-3
    robot.run(0.1)
    assert robot.controller.state[0] == pytest.approx(motion(robot.time), abs=1e-3)


def changed(**fields: Any) -> ServoChunk:
    return chunk_of(np.tile(HOME, (5, 1)), 0.0, **fields)


@pytest.mark.parametrize(
    ("told", "field", "says"),
    [
        (changed(stamp=UNIX + 0.5), "stamp", "in the future"),
        (changed(stamp=UNIX - 3.0), "stamp", "3.000 s ago"),
        (changed(start=UNIX - 1.0), "start", "ended"),
        (changed(start=UNIX + 60.0), "start", "60.0 s after"),
        (changed(dt=None), "dt", "either"),
        (changed(time=(0.0, 0.1, 0.2, 0.3, 0.4)), "dt", "either"),
        (changed(dt=None, time=(0.0, 0.1, 0.1, 0.3, 0.4)), "time", "0.001 s"),
        (changed(dt=None, time=(0.0, 0.1)), "points.position", "2 points"),
        (changed(points=JointPoints(kind="joints", position=((0.0,) * 5,) * 5)), "points.position[0]", "6 joints"),
        (changed(points=JointPoints(kind="joints", position=(tuple(HOME + 1.0),) * 5)), "points", "1.00 rad"),
        (changed(dt=60.0), "dt", "at most 60 s"),
        (changed(points=JointPoints(kind="joints", position=((2e3,) * 6,) * 5)), "points.position[0]", "rad"),
        (changed(opening=(0.0,) * 5), "gripper", "together"),
        (changed(opening=(0.0,) * 5, gripper="hand"), "gripper", "no gripper"),
    ],
)
def test_an_invalid_chunk_is_refused_by_field(told: ServoChunk, field: str, says: str) -> None:
    robot = Follower()
    with pytest.raises(InvalidRequest, match=says) as refused:
        robot.take(told)
    assert refused.value.problem.field == field
    robot.run(0.2)
    assert np.array_equal(robot.controller.state[0], HOME)


def test_a_chunk_that_came_before_is_refused() -> None:
    robot = Follower()
    robot.take(changed(sequence=2))
    for number in (1, 2):
        with pytest.raises(InvalidRequest, match="came after chunk 2"):
            robot.take(changed(sequence=number))


def test_a_jump_is_measured_from_where_the_robot_is_or_would_be() -> None:
    robot = Follower()
    assert robot.take(chunk(lambda _: HOME + JUMP - 0.01, 0.0, 5)).jump == pytest.approx(JUMP - 0.01)


def test_a_joint_target_is_extrapolated() -> None:
    target = JointTarget(HOME, np.full(6, 0.2), np.full(6, 0.1))
    assert target.after(0.5).position == pytest.approx(HOME + 0.1 + 0.0125)
    assert target.after(0.5).velocity == pytest.approx(np.full(6, 0.25))


def test_the_gripper_gets_the_last_opening_of_a_short_chunk(monkeypatch: pytest.MonkeyPatch) -> None:
    follower, asked = Follower(), list[float]()
    monkeypatch.setattr(chunk_tracking.clock, "monotonic", lambda: follower.time - 0.05)  # steps are ahead of now
    follower.tracking._grip = SimpleNamespace(follow=lambda chunk, time: asked.append(chunk.opening(time)))  # type: ignore[assignment]
    follower.take(chunk_of(np.tile(HOME, (10, 1)), 0.0))
    follower.inbox._references = [
        replace(one, gripper="hand", openings=np.linspace(0.08, 0.02, len(one.motion.time)))
        for one in follower.inbox._references
    ]
    follower.run(1.0)
    assert asked[-2] > 0.021
    assert asked[-1] == pytest.approx(0.02)
