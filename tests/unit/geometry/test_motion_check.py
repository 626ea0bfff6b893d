"""What the check of motions promises: a motion that it calls free keeps its margin all the time, between its samples too."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.composed import torso_with_arms
from support.examples import examples
from support.planner.small_arm import small_arm
from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Attached, Capsule, Cuboid, Cylinder, SceneObject, Sphere
from zarm_contract.robot import load_robot
from zarm_geometry.exact import ExactScene
from zarm_geometry.motion_check import MotionCheck
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.situation import MovingObject
from zarm_geometry.world import World
from zarm_trajectory.arrays import Array

MARGIN = 0.01
DENSE = 1500
"""Samples of the independent look at a motion: no point of a robot moves further than 2 mm between two of them."""
PRECISION = 2e-5
BETWEEN = 0.001
"""What one sample of the dense look may miss (m)."""
EARLY = 0.004
"""A contact may be reported this far (m) ahead: of what is between two samples, the check knows bounds alone."""


@cache
def model(name: str) -> RobotModel:
    if name not in ("small_arm", "torso_arms"):
        return RobotModel.of(load_robot(name))
    with tempfile.TemporaryDirectory() as folder:
        if name == "small_arm":
            return RobotModel.of(small_arm(Path(folder)))
        return RobotModel.of(load_robot(str(torso_with_arms(Path(folder)))))


def swing(robot: RobotModel, rng: np.random.Generator) -> tuple[Callable[[Array], Array], Array, float]:
    """A motion of random length with overshoot in some joints, the accelerations that it reaches, and how long it takes."""
    low, high = np.maximum(robot.lower, -2.5), np.minimum(robot.upper, 2.5)
    start = rng.uniform(low, high)
    way, wave = rng.normal(0.0, 0.5, robot.dof), rng.normal(0.0, 0.1, robot.dof)
    duration = rng.uniform(0.3, 1.5)

    def at(time: Array) -> Array:
        u = (np.asarray(time) / duration)[..., None]
        return start + way * u**3 * (10 - 15 * u + 6 * u * u) + wave * np.sin(2 * np.pi * u) * u * u * (1 - u) ** 2

    fine = at(np.linspace(0.0, duration, 20_000))
    step = duration / 19_999
    acceleration = 1.02 * np.abs(np.diff(fine, 2, axis=0)).max(axis=0) / step**2
    return at, acceleration, duration


def thing(rng: np.random.Generator, index: int) -> SceneObject:
    name = f"thing{index}"
    away = rng.normal(size=3)
    position = tuple((away / np.linalg.norm(away) * rng.uniform(0.3, 1.2) + (0.0, 0.0, 0.3)).tolist())
    q = rng.normal(size=4)
    orientation = tuple((q / np.linalg.norm(q)).tolist())
    radius, length = rng.uniform(0.01, 0.08), rng.uniform(0.01, 0.4)
    if index % 4 == 0:
        size = tuple(rng.uniform(0.01, 0.3, 3).tolist())
        return Cuboid(kind="cuboid", name=name, position=position, orientation=orientation, size=size)
    if index % 4 == 1:
        return Sphere(kind="sphere", name=name, position=position, radius=radius)
    kind = Capsule if index % 4 == 2 else Cylinder
    return kind(
        kind=kind.__name__.lower(), name=name, position=position, orientation=orientation, radius=radius, length=length
    )


@pytest.mark.lengthy
@pytest.mark.parametrize("robot", ["doosan_m1013", "panda", "ur5e", "small_arm", "torso_arms"])
@examples(1.0)
@given(seed=st.integers(0, 2**32 - 1))
def test_free_motions_keep_the_margin_by_a_dense_check(robot: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    arm = model(robot)
    objects = [thing(rng, i) for i in range(rng.integers(0, 12))]
    world = World(objects, 0.005)
    check = MotionCheck(arm)
    check.set_world(world)
    at, acceleration, duration = swing(arm, rng)
    times = np.arange(0.0, duration, rng.choice([0.004, 0.02, 0.05]))
    verdict = check.check(times, at(times), margin=MARGIN, acceleration=acceleration)
    end = times[-1] if verdict.contact_time is None else verdict.contact_time
    proven = at(np.linspace(0.0, end, DENSE)) if end > 0.0 else np.empty((0, arm.dof))
    exact = ExactScene(arm, world)
    if len(proven):
        assert not exact.too_near(proven, 0.0, MARGIN - PRECISION, MARGIN - PRECISION)
        assert exact.nearest(proven).distance > 0.0
    assert verdict.free == (verdict.contact_time is None)
    if not verdict.free:
        assert verdict.link in arm.links
        assert verdict.object in {*arm.links, *(item.name for item in objects)}
        if times[1] < 0.005:  # and it is right, but for what may be between two samples
            after = at(np.linspace(end, end + times[1], 50))
            assert exact.nearest(after).distance < MARGIN + EARLY


@pytest.mark.lengthy
@examples(1.0)
@given(seed=st.integers(0, 2**32 - 1))
def test_what_moves_is_everywhere_that_it_may_be(seed: int) -> None:
    rng = np.random.default_rng(seed)
    arm = model("ur5e")
    check = MotionCheck(arm)
    at, acceleration, duration = swing(arm, rng)
    velocity, speed, seen = rng.normal(0.0, 0.3, 3), rng.uniform(0.0, 0.3), rng.uniform(-0.2, 0.2)
    ball = Sphere(kind="sphere", name="ball", position=tuple(rng.uniform(-0.7, 0.7, 3).tolist()), radius=0.05)
    offset, growth = rng.normal(0.0, 0.1, 3), rng.uniform(0.0, 0.05)
    mover = MovingObject(ball, tuple(velocity.tolist()), speed, seen, tuple(offset.tolist()), growth)
    times = np.arange(0.0, duration, 0.01)
    verdict = check.check(times, at(times), margin=MARGIN, acceleration=acceleration, moving=[mover])
    end = times[-1] if verdict.contact_time is None else verdict.contact_time
    for t in np.linspace(0.0, end, 40):
        place = np.array(ball.position) + offset + velocity * (t - seen)
        radius = 0.05 + growth + speed * abs(t - seen)
        grown = Sphere(kind="sphere", name="ball", position=tuple(place.tolist()), radius=radius)
        near = ExactScene(arm, World([grown], 0.0)).nearest(at(np.array([t])))
        assert end == 0.0 or near.distance >= MARGIN - PRECISION


def test_close_links_keep_the_margin_they_can() -> None:
    check = MotionCheck(model("doosan_m1013"))
    assert check.check(TIMES, TURN, margin=0.05).free
    nearest = check.nearby(HOME, within=0.05)[0]
    assert {nearest.link, nearest.object} == {"base_link", "link_2"}
    assert nearest.kept_margin < nearest.distance < 0.05
    box = Cuboid(kind="cuboid", name="box", position=(1.0, 0.0, 1.0), size=(0.1, 0.1, 0.1))
    check.update([box])
    assert next(pair for pair in check.nearby(HOME, within=2.0) if pair.object == "box").kept_margin == np.inf


HOME = np.array(model("doosan_m1013").robot.descriptor.home)
TIMES = np.arange(0.0, 1.0001, 0.01)
TURN = HOME + np.outer(TIMES**3 * (10 - 15 * TIMES + 6 * TIMES**2), [0.8, 0, 0, 0, 0, 0])
"""Home turned about the first joint."""
FAST = np.full(6, 6.0)


def in_the_way(name: str, at: float) -> Sphere:
    """A ball where the tip is at a part of TURN."""
    tip = model("doosan_m1013").fk_tip(TURN[round(at * 100)])[:3, 3]
    return Sphere(kind="sphere", name=name, position=tuple(tip.tolist()), radius=0.03)


def test_a_verdict_names_object_link_and_time_before_contact() -> None:
    check = MotionCheck(model("doosan_m1013"))
    check.set_world(World([in_the_way("post", 0.5)], 0.0))
    verdict = check.check(TIMES, TURN, margin=MARGIN, acceleration=FAST)
    assert not verdict.free
    assert (verdict.object, verdict.link) == ("post", "link_6")
    assert verdict.contact_time is not None
    assert 0.3 < verdict.contact_time < 0.5
    late = check.check(TIMES + 7.0, TURN, margin=MARGIN, acceleration=FAST)
    assert late.contact_time == pytest.approx(verdict.contact_time + 7.0)


def test_an_object_may_be_checked_inflated_and_displaced() -> None:
    check, box = MotionCheck(model("doosan_m1013")), in_the_way("post", 0.5)
    cube = Cuboid(kind="cuboid", name="cube", position=box.position, size=(0.04, 0.04, 0.04))

    def contact(**changed: Any) -> float | None:
        moving = [MovingObject(cube, **changed)]
        return check.check(TIMES, TURN, margin=MARGIN, acceleration=FAST, moving=moving).contact_time

    there, grown, away = contact(), contact(growth=0.05), contact(offset=(0.0, 0.0, 1.0))
    assert there is not None
    assert grown is not None
    assert grown < there
    assert away is None


def test_a_situation_stays_as_it_was_and_the_next_one_is_new() -> None:
    check = MotionCheck(model("doosan_m1013"))
    before = check.situation()
    check.update([in_the_way("post", 0.5)])
    assert before.check(TIMES, TURN, margin=MARGIN, acceleration=FAST).free
    assert not check.situation().check(TIMES, TURN, margin=MARGIN, acceleration=FAST).free


def test_a_start_that_is_too_near_is_a_contact_at_the_first_time() -> None:
    check = MotionCheck(model("doosan_m1013"))
    check.set_world(World([in_the_way("post", 0.0)], 0.0))
    assert check.check(TIMES, TURN, margin=MARGIN, acceleration=FAST).contact_time == 0.0
    assert check.check([3.0], HOME, margin=MARGIN).contact_time == 3.0


def test_one_object_at_a_time_is_as_a_new_world() -> None:
    check = MotionCheck(model("doosan_m1013"))
    check.set_world(World([in_the_way("late", 0.7)], 0.0))
    late = check.check(TIMES, TURN, margin=MARGIN, acceleration=FAST)
    check.update([in_the_way("early", 0.4)])
    early = check.check(TIMES, TURN, margin=MARGIN, acceleration=FAST)
    assert (late.object, early.object) == ("late", "early")
    check.update([], ["early"])
    assert check.check(TIMES, TURN, margin=MARGIN, acceleration=FAST) == late
    check.update([], ["late", "never seen"])
    assert check.check(TIMES, TURN, margin=MARGIN, acceleration=FAST).free
    check.update([in_the_way("late", 0.4)])
    assert check.check(TIMES, TURN, margin=MARGIN, acceleration=FAST).contact_time == early.contact_time


def test_attached_objects_collide_and_ignored_links_do_not() -> None:
    arm = model("doosan_m1013")
    check = MotionCheck(arm)
    tip = arm.fk_tip(TURN[60])
    beyond = tip[:3, 3] + 0.25 * tip[:3, 2]
    check.set_world(World([Sphere(kind="sphere", name="post", position=tuple(beyond.tolist()), radius=0.02)], 0.0))
    assert check.check(TIMES, TURN, margin=MARGIN, acceleration=FAST).free
    stick = Capsule(
        kind="capsule", name="stick", position=(0, 0, 0.15), orientation=(0, 0, 0, 1), radius=0.01, length=0.2
    )
    held = Attached(object=stick, touch_links=("link_6", "link_5"))
    verdict = check.check(TIMES, TURN, margin=MARGIN, acceleration=FAST, attached=[held])
    assert (verdict.object, verdict.link) == ("post", "stick")
    check.set_world(World([in_the_way("post", 0.5)], 0.0))
    assert check.check(TIMES, TURN, margin=MARGIN, acceleration=FAST, ignored_links=["link_4", "link_5", "link_6"]).free


@pytest.mark.parametrize(
    ("times", "positions"),
    [
        ([0.0, 0.0], [HOME, HOME]),
        ([0.0, 1.0], [HOME]),
        ([0.0], [HOME[:5]]),
        ([0.0, np.nan], [HOME, HOME]),
        ([0.0], [np.full(6, np.inf)]),
        ([], np.empty((0, 6))),
    ],
)
def test_what_is_no_motion_is_refused(times: list[float], positions: list[Array]) -> None:
    with pytest.raises(InvalidRequest):
        MotionCheck(model("doosan_m1013")).check(times, positions, margin=MARGIN)


def situation(arm: RobotModel, rng: np.random.Generator, things: int) -> tuple[MotionCheck, World, Array]:
    """A check among random objects, and a configuration."""
    world = World([thing(rng, i) for i in range(things)], 0.005)
    check = MotionCheck(arm)
    check.set_world(world)
    return check, world, rng.uniform(np.maximum(arm.lower, -2.5), np.minimum(arm.upper, 2.5))


@pytest.mark.parametrize("robot", ["doosan_m1013", "small_arm", "torso_arms"])
@examples(1.0)
@given(seed=st.integers(0, 2**32 - 1))
def test_what_is_nearby_is_as_far_as_the_exact_check_says(robot: str, seed: int) -> None:
    arm = model(robot)
    check, world, q = situation(arm, np.random.default_rng(seed), 4)
    pairs = check.nearby(q, within=0.9)
    nearest = ExactScene(arm, world).nearest(q)
    if nearest.distance > 0.0:
        assert pairs[0].distance == pytest.approx(nearest.distance, abs=1e-4)
    assert [pair.distance for pair in pairs] == sorted(pair.distance for pair in pairs)


@pytest.mark.parametrize("robot", ["doosan_m1013", "small_arm", "torso_arms"])
def test_distance_gradients_match_finite_differences(robot: str) -> None:
    """Against difference quotients. Where two parts of a link are as near as each other, or a face lies along another,
    there is no derivative: of all pairs those are one in a hundred."""
    arm, step, errors = model(robot), 1e-3, []
    for seed in range(40):
        check, _, q = situation(arm, np.random.default_rng(seed), 3)

        def distances(at: Array, check: MotionCheck = check) -> dict[tuple[str, str], float]:
            return {(pair.link, pair.object): pair.distance for pair in check.nearby(at, within=0.6)}

        sides = [(distances(q - step * joint), distances(q + step * joint)) for joint in np.eye(arm.dof)]
        for pair in check.nearby(q, within=0.5):
            between = pair.link, pair.object
            if pair.distance > 0.05 and all(between in side for both in sides for side in both):
                quotient = [(after[between] - before[between]) / (2.0 * step) for before, after in sides]
                errors.append(float(np.abs(pair.gradient - quotient).max()))
    assert len(errors) > 250
    assert np.quantile(errors, 0.98) < 0.003  # m/rad


def test_an_object_along_a_link_counts_at_the_shared_middle() -> None:
    """A capsule, level above a block that begins under its second half: either end of what they share may come down."""
    arm = model("small_arm")
    q = np.array([0.0, np.pi / 2, 0.0, 0.0])
    pose = arm.fk_link("upper", q)
    along, origin = pose[:3, 2], pose[:3, 3]
    first, last, half = 0.2, 0.32, 0.2  # where the block begins, and the core of the capsule ends
    center = origin + (first + half) * along - np.array([0.0, 0.0, 0.2])
    block = Cuboid(kind="cuboid", name="block", position=tuple(center.tolist()), size=(2 * half, 2 * half, 0.1))
    check = MotionCheck(arm)
    check.set_world(World([block], 0.0))
    (pair,) = (one for one in check.nearby(q, within=0.5) if (one.link, one.object) == ("upper", "block"))
    assert abs(along[2]) < 1e-9
    assert abs(pair.gradient[1]) == pytest.approx((first + last) / 2, abs=1e-3)
