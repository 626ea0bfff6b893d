from __future__ import annotations

import numpy as np
import pytest

from support.planner.client import BEHIND_POST, POST
from support.planner.second_opinion import Collisions
from support.trajectories import HOME, RATE_LIMITS, ROBOT, rest_to_rest
from zarm_contract.messages import Attached, Cuboid, SceneObject, Touch
from zarm_geometry.meshes import Meshes
from zarm_geometry.robot_model import RobotModel
from zarm_servo.guarding.stopping import StoppingTime
from zarm_servo.world.check import Checker
from zarm_servo.world.moving_objects import Mover
from zarm_servo.world.scene_monitor import SceneSnapshot
from zarm_trajectory.follower import Follower
from zarm_trajectory.trajectory import TimedTrajectory

MODEL = RobotModel.of(ROBOT)
WAY = TimedTrajectory.of(rest_to_rest(np.array(BEHIND_POST), HOME), ROBOT.descriptor.joints)
EMPTY = SceneSnapshot("1-000000000000")


def seen(*objects: SceneObject, attached: tuple[Attached, ...] = ()) -> SceneSnapshot:
    return SceneSnapshot("2-000000000000", {item.name: item for item in objects}, attached)


@pytest.fixture
def checker() -> Checker:
    return Checker(MODEL, Meshes())


def test_a_check_gives_the_latest_stop_and_the_obstacle(checker: Checker) -> None:
    found = checker.validity(WAY, 0.0, seen(POST), EMPTY)
    assert found.obstruction is not None
    assert found.until is not None
    assert found.obstruction.object == "post"
    collisions = Collisions(ROBOT, (POST,))
    touching = next(time for time in np.arange(0.0, WAY.duration, 0.002) if collisions.at(WAY.at(time)[0]))
    assert touching - 0.1 < found.obstruction.time <= touching
    assert found.obstruction.time - 0.3 < found.until < found.obstruction.time


def test_what_the_robot_has_passed_does_not_matter(checker: Checker) -> None:
    first = checker.validity(WAY, 0.0, seen(POST), EMPTY)
    assert first.obstruction is not None
    collisions = Collisions(ROBOT, (POST,))
    last = max(time for time in np.arange(0.0, WAY.duration, 0.01) if collisions.at(WAY.at(time)[0]))
    assert checker.validity(WAY, last + 0.1, seen(POST), EMPTY).until is None


def test_what_was_verified_and_unchanged_is_not_checked_again(checker: Checker) -> None:
    assert checker.validity(WAY, 0.0, seen(POST), seen(POST)).until is None
    assert checker.validity(WAY, 0.0, seen(POST), None).until is not None
    moved = POST.model_copy(update={"position": (0.37, 0.38, 0.4)})
    assert checker.validity(WAY, 0.0, seen(moved), seen(POST)).until is not None


def test_verified_close_links_do_not_hold_the_robot(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("zarm_servo.world.check.CONTACT", 0.05)  # the M1013 has 16 mm at home
    monkeypatch.setattr("zarm_geometry.situation._LEAST_KEPT", 0.05)  # and is to keep it, though it never can
    checker = Checker(MODEL, Meshes())
    far = POST.model_copy(update={"position": (-1.5, 0.0, 0.0)})
    assert checker.validity(WAY, 0.0, seen(far), EMPTY).until is None
    assert checker.validity(WAY, 0.0, seen(far), None).until is not None


def test_with_another_object_attached_everything_is_looked_at(checker: Checker) -> None:
    stick = Cuboid(kind="cuboid", name="stick", position=(0.0, 0.0, 0.3), size=(0.02, 0.02, 0.5))
    x, y, z = MODEL.fk_tip(WAY.at(WAY.duration / 2)[0])[:3, 3].tolist()
    shelf = Cuboid(kind="cuboid", name="shelf", position=(x, y, z - 0.4), size=(0.05, 0.05, 0.05))
    assert checker.validity(WAY, 0.0, seen(shelf), seen(shelf)).until is None
    found = checker.validity(WAY, 0.0, seen(shelf, attached=(Attached(object=stick),)), seen(shelf))
    assert found.obstruction is not None
    assert (found.obstruction.object, found.obstruction.link) == ("shelf", "stick")


def test_after_any_number_of_changes_the_last_objects_count(checker: Checker) -> None:
    for turn in range(150):
        far = POST.model_copy(update={"name": f"far{turn}", "position": (-1.5, 0.0, 0.01 * turn)})
        assert checker.validity(WAY, 0.0, seen(far), EMPTY).until is None
    assert checker.validity(WAY, 0.0, seen(POST), EMPTY).until is not None
    assert checker.validity(WAY, 0.0, seen(), EMPTY).until is None


def coming(position: tuple[float, float, float], speed: float) -> Mover:
    """A post that was told to be there just now, and moves no faster than this."""
    return Mover(POST, POST.model_copy(update={"position": position}), (0.0, 0.0, 0.0), speed, seen=0.0, stamp=0.0)


def test_a_robot_rests_before_a_moving_object_s_reach(checker: Checker) -> None:
    away = coming((1.5, 1.5, POST.position[2]), 0.1)
    assert checker.validity_among(WAY, 0.0, EMPTY, [away], now=0.0, stopping=0.5).until is None
    here = coming(POST.position, 0.1)
    slowly = checker.validity_among(WAY, 0.0, EMPTY, [here], now=0.0, stopping=0.5)
    longer = checker.validity_among(WAY, 0.0, EMPTY, [here], now=0.5, stopping=0.5)
    standing = checker.validity(WAY, 0.0, seen(POST), EMPTY)
    assert slowly.obstruction is not None
    assert slowly.obstruction.object == "post"
    assert slowly.until is not None
    assert longer.until is not None
    assert standing.obstruction is not None
    assert longer.until < slowly.until < standing.obstruction.time


def test_the_time_to_rest_holds_for_an_executor_that_brakes_then() -> None:
    stopping = StoppingTime(WAY, RATE_LIMITS, reaction=0.1)
    for time in np.linspace(0.0, WAY.duration - 0.1, 7):
        follower = Follower(WAY, RATE_LIMITS, time=time + 0.1, target=0.0)
        ticks = 0
        while not follower.at_rest:
            follower.advance(0.01)
            ticks += 1
        assert 0.01 * ticks + 0.1 <= stopping.after(float(time))


def test_what_may_be_touched_for_a_time_is_no_obstacle_then(checker: Checker) -> None:
    found = checker.validity(WAY, 0.0, seen(POST), EMPTY)
    assert found.until is not None
    assert found.obstruction is not None
    whole = Touch(objects=("post",), begin=0.0, end=WAY.duration)
    assert checker.validity(WAY, 0.0, seen(POST), EMPTY, touches=(whole,)).until is None
    before = Touch(objects=("post",), begin=0.0, end=found.until / 2)
    left = checker.validity(WAY, 0.0, seen(POST), EMPTY, touches=(before,)).obstruction
    assert left is not None
    assert left.object == found.obstruction.object
    assert left.time == pytest.approx(found.obstruction.time, abs=0.02)
    other = Touch(objects=("ball",), begin=0.0, end=WAY.duration)
    assert checker.validity(WAY, 0.0, seen(POST), EMPTY, touches=(other,)) == found
