"""How far a goal may go before an object that moves."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import numpy as np

from support.planner.second_opinion import link_pose
from support.trajectories import HOME, ROBOT, SCENE, moved, rest_to_rest
from zarm_contract.codec import encode
from zarm_contract.messages import Authority, GoalState, GoalTrajectory, JointState, ObjectPose, Scene, Sphere
from zarm_geometry.meshes import Meshes
from zarm_geometry.robot_model import RobotModel
from zarm_runtime.metrics import Metrics
from zarm_servo.guarding.guard import Guard
from zarm_servo.world.check import Checker
from zarm_servo.world.world_monitor import WorldMonitor

JOINTS = ROBOT.descriptor.joints
END = moved(1.5, 0.0)


def until(lag: float) -> float:
    """How far (s) a robot that had this `lag` (s) may go towards an object that moves at up to 0.2 m/s where its way ends."""
    here = JointState(stamp=time.time(), joint_names=JOINTS, position=tuple(HOME.tolist()), velocity=(0.0,) * 6)
    measured: Any = SimpleNamespace(get=lambda max_age=1.0: here)
    world, authorities = WorldMonitor(measured, Meshes(), ROBOT.descriptor), list[Authority]()
    guard = Guard(
        ROBOT.descriptor,
        Checker(RobotModel.of(ROBOT), Meshes()),
        world,
        SimpleNamespace(put=authorities.append),  # type: ignore[arg-type]
        SimpleNamespace(set=lambda _: None),  # type: ignore[arg-type]
        "servo",
        Metrics(),
        session=lambda: None,
        validity=lambda *_: None,
        collision_detection=lambda: "off",
    )
    place = tuple(link_pose(ROBOT, ROBOT.descriptor.tip_link, END)[:3, 3].tolist())
    ball = Sphere(kind="sphere", name="ball", position=place, radius=0.05)
    world.scene.on_scene("", Scene(revision=SCENE, objects=(ball,)))
    pose = encode(ObjectPose(stamp=time.time(), position=place, speed=0.2))
    world.moving.update_object("ball", pose, time.monotonic(), time.time())
    world.lag.on_goal(GoalState.model_construct(lag=lag))
    way = rest_to_rest(END, HOME)
    guard.on_trajectory(GoalTrajectory(goal_id="goal-1", number=1, start=0.0, trajectory=way, scene_revision=SCENE))
    guard._check()
    assert authorities[-1].until is not None
    return authorities[-1].until


def test_a_robot_that_lags_stops_further_from_what_moves() -> None:
    ends = [until(lag) for lag in (0.0, 0.1, 0.2)]
    assert (np.diff(ends) <= -0.02).all()
