"""A deadline that others bring forward, and those that end sooner with it."""

from __future__ import annotations

import numpy as np
import pytest

from zarm_contract.errors import Cancelled, DeadlineExceeded
from zarm_contract.messages import Sphere
from zarm_contract.robot import load_robot
from zarm_geometry.exact import ExactScene
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.deadline import GUARANTEED, Deadline
from zarm_planner.scene.planning_scene import PlanningScene
from zarm_planner.verification.margins import too_near
from zarm_planner.verification.waypoints import passing_times
from zarm_trajectory.trajectory import TimedTrajectory


def test_a_sooner_deadline_ends_no_later_and_with_a_cancel() -> None:
    stop = Deadline(60.0)
    sooner, later = stop.sooner(1.0), stop.sooner(600.0)
    assert sooner.at[0] < stop.at[0]
    assert later.at[0] == pytest.approx(stop.at[0])
    stop.cancel()
    for one in (stop, sooner, later, stop.sooner(1.0)):
        with pytest.raises(Cancelled):
            one.check()


def test_a_sooner_deadline_leaves_the_other_alone() -> None:
    stop = Deadline(60.0)
    passed, cancelled = stop.sooner(-1.0), stop.sooner(1.0)
    cancelled.cancel()
    with pytest.raises(DeadlineExceeded):
        passed.check()
    stop.check()


def test_yielding_keeps_the_guarantee_and_the_deadline() -> None:
    stop = Deadline(60.0)
    before = stop.at[0]
    long, short, cancelled = stop.sooner(30.0), stop.sooner(GUARANTEED / 2), stop.sooner(30.0)
    soon = short.at[0]
    cancelled.cancel()
    stop.give_way()
    assert long.at[0] == pytest.approx(before - 60.0 + GUARANTEED, abs=1e-3)
    assert (stop.at[0], short.at[0]) == (before, soon)
    assert cancelled.cancelled


def test_what_is_asked_of_a_trajectory_that_is_found_looks_at_it() -> None:
    """Whether it passes its waypoints, and which margins it does not keep."""
    model = RobotModel.of(load_robot("panda"))
    home = np.array(model.robot.descriptor.home)
    ball = Sphere(kind="sphere", name="ball", position=tuple(model.fk_tip(home)[:3, 3].tolist()), radius=0.01)
    world = World([ball], 0.2)
    scene = PlanningScene("1-000000000000", model, world, ExactScene(model, world))
    standing, stop = TimedTrajectory.standing(home, 0.01), Deadline(60.0)
    assert passing_times(model, standing, [home[None]], 0.005, 0.02, stop.check)
    assert too_near(scene, standing, 0.0, stop.check)
    stop.cancel()
    with pytest.raises(Cancelled):
        passing_times(model, standing, [home[None]], 0.005, 0.02, stop.check)
    with pytest.raises(Cancelled):
        too_near(scene, standing, 0.0, stop.check)
