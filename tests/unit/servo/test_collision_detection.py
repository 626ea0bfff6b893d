"""A collision is felt by the efforts of the joints: what they exert less what the motion needs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from zarm_contract.descriptor import StatedJointDynamics
from zarm_contract.errors import Unavailable
from zarm_contract.messages import (
    Attached,
    ExecutorState,
    ExternalTorque,
    JointState,
    Nothing,
    Scene,
    Sphere,
)
from zarm_contract.robot import RobotDescription, load_robot
from zarm_geometry.robot_model import RobotModel
from zarm_servo.guarding.collision_detection import CollisionDetection
from zarm_servo.world.scene_monitor import SceneMonitor
from zarm_trajectory.arrays import Array

UR5E = load_robot("ur5e")
MODEL = RobotModel.of(UR5E)
HOME = np.array(UR5E.descriptor.home)
LIMITS = (20.0, 20.0, 20.0, 5.0, 5.0, 5.0)
PERIOD = 0.01
PUSH = np.array([0.0, 0.0, -60.0])
"""N, on the tip."""


JOINTS = StatedJointDynamics(
    friction=(15.0, 15.0, 15.0, 3.0, 3.0, 3.0), damping=(15.0, 15.0, 15.0, 3.0, 3.0, 3.0), armature=(0.0,) * 6
)


def limited(
    robot: RobotDescription, limits: Sequence[float] | None = LIMITS, joints: StatedJointDynamics | None = None
) -> RobotModel:
    known = {"external_torque_limits": limits, "joint_dynamics": joints}
    execution = robot.descriptor.execution.model_copy(update=known)
    return RobotModel.of(replace(robot, descriptor=robot.descriptor.model_copy(update={"execution": execution})))


class Felt:
    """A detection, the motion that it is shown, and what it publishes."""

    def __init__(self, model: RobotModel) -> None:
        self.scene = SceneMonitor(lambda: None)
        self.messages: list[ExternalTorque] = []
        self.changes: list[str] = []
        self.detection = CollisionDetection(
            model, self.scene, self.messages.append, lambda: self.changes.append(self.detection.state)
        )
        self.run("goal-1")

    def run(self, goal_id: str | None) -> None:
        mode = "idle" if goal_id is None else "running"
        self.detection.on_state(
            ExecutorState(mode=mode, strategy="joint_trajectory", goal_id=goal_id, speed_scale=1.0, missed_ticks=0)
        )

    def move(
        self,
        seconds: float = 1.0,
        outside: Callable[[float, Array], Array] = lambda _, q: np.zeros(len(q)),
        *,
        begin: float = 0.0,
        names: Sequence[str] = UR5E.descriptor.joints,
        dynamics: RobotModel = MODEL,
    ) -> None:
        """Swing all joints; `outside(t, q)` are the torques from outside."""
        order = [UR5E.descriptor.joints.index(name) for name in names]
        for t in begin + np.arange(0.0, seconds, PERIOD):
            q = HOME + 0.3 * np.sin(2.0 * t)
            v, a = np.full(6, 0.6 * np.cos(2.0 * t)), np.full(6, -1.2 * np.sin(2.0 * t))
            effort = dynamics.dynamics.torque(q[None], v[None], a[None])[0] - outside(t, q)
            rows = [tuple(each[order].tolist()) for each in (q, v, effort)]
            self.detection.on_joints(
                "", JointState(stamp=1e9 + t, joint_names=names, position=rows[0], velocity=rows[1], effort=rows[2])
            )

    def collisions(self) -> list[ExternalTorque]:
        return [message for message in self.messages if message.joint is not None]


def pushed(t: float, q: Array) -> Array:
    """A push on the tip from 0.5 s on."""
    return MODEL.tip_jacobian(q)[:3].T @ PUSH * (t >= 0.5)


def rubbed(t: float, q: Array) -> Array:
    """The friction of the joints, in the motion of `move`."""
    velocity = 0.6 * np.cos(2.0 * t)
    return -(np.sign(velocity) * np.array(JOINTS.friction) + velocity * np.array(JOINTS.damping))


def test_a_motion_as_the_model_says_is_no_collision() -> None:
    felt = Felt(limited(UR5E))
    felt.move(3.0)
    assert felt.messages
    assert not felt.collisions()
    assert max(felt.messages[-1].largest) < 0.5, "only what 20 ms smooth out"


def test_a_push_is_felt_within_three_joint_states() -> None:
    felt = Felt(limited(UR5E))
    felt.move(1.0, pushed)
    first = felt.collisions()[0]
    assert first.stamp - 1e9 - 0.5 == pytest.approx(0.01, abs=0.015)
    assert first.goal_id == "goal-1"
    expected = MODEL.tip_jacobian(HOME + 0.3 * np.sin(2.0))[:3].T @ PUSH
    np.testing.assert_allclose(felt.messages[-1].torque, expected, atol=2.0)
    worst = int(np.argmax(np.abs(first.torque) / np.array(LIMITS)))
    assert first.joint == UR5E.descriptor.joints[worst]


def test_it_is_said_again_until_the_goal_has_ended() -> None:
    """A message may be lost; the robot must stop all the same."""
    felt = Felt(limited(UR5E))
    felt.move(1.0, pushed)
    assert len(felt.collisions()) > 40


def test_a_push_on_a_robot_without_a_goal_ends_nothing() -> None:
    felt = Felt(limited(UR5E))
    felt.run(None)
    felt.move(1.0, pushed)
    assert not felt.collisions()
    assert max(map(abs, felt.messages[-1].torque)) > 10.0


def test_what_the_robot_carries_is_no_collision() -> None:
    load = Attached(
        object=Sphere(kind="sphere", name="load", position=(0.0, 0.0, 0.05), radius=0.05), link="tool0", mass=5.0
    )
    heavy = MODEL.with_attached((load,), ())
    for carried in (True, False):
        felt = Felt(limited(UR5E))
        if carried:
            felt.scene.on_scene("", Scene(revision="1-0123456789ab", attached=(load,)))
        felt.move(1.0, dynamics=heavy)
        assert bool(felt.collisions()) is not carried


def test_joints_are_read_by_name() -> None:
    felt = Felt(limited(UR5E))
    felt.move(names=tuple(reversed(UR5E.descriptor.joints)))
    assert felt.messages
    assert not felt.collisions()


def test_after_a_gap_old_samples_are_not_used() -> None:
    felt = Felt(limited(UR5E))
    felt.move(0.3)
    felt.move(0.3, begin=0.9)
    assert not felt.collisions()
    assert max(felt.messages[-1].largest) < 0.5


def test_stated_friction_is_no_collision() -> None:
    for known in (True, False):
        felt = Felt(limited(UR5E, joints=JOINTS if known else None))
        felt.move(3.0, rubbed)
        assert bool(felt.collisions()) is not known


def test_what_is_identified_is_the_friction_of_the_joints() -> None:
    felt = Felt(limited(UR5E, None))
    felt.move(12.0, rubbed)
    found = felt.detection.identify(Nothing())
    np.testing.assert_allclose(found.friction, JOINTS.friction, rtol=0.15)
    np.testing.assert_allclose(found.damping, JOINTS.damping, rtol=0.25)


def test_nothing_is_identified_at_rest() -> None:
    felt = Felt(limited(UR5E, None))
    felt.run(None)
    felt.move(12.0, rubbed)
    with pytest.raises(Unavailable, match="0 joint states of motions are too few"):
        felt.detection.identify(Nothing())


def test_without_efforts_or_inertia_identification_says_so() -> None:
    with pytest.raises(Unavailable, match="the driver reports no efforts"):
        Felt(limited(UR5E, None)).detection.identify(Nothing())
    with pytest.raises(Unavailable, match="does not state the inertia of each link"):
        Felt(limited(load_robot("doosan_m1013"), None)).detection.identify(Nothing())


def test_the_largest_torque_is_that_of_the_goal() -> None:
    felt = Felt(limited(UR5E, None))
    felt.move(1.0, pushed)
    assert max(felt.messages[-1].largest) > 10.0
    felt.run("goal-2")
    felt.move(1.0, begin=2.0)
    assert max(felt.messages[-1].largest) < 0.5


def test_its_state_says_what_is_missing() -> None:
    assert Felt(limited(UR5E, None)).detection.state == "off"
    assert Felt(limited(load_robot("doosan_m1013"))).detection.state == "no_inertia"
    felt = Felt(limited(UR5E))
    assert felt.detection.state == "no_effort"
    felt.move(0.1)
    assert felt.changes == ["on"]
    state = JointState(
        stamp=2e9, joint_names=UR5E.descriptor.joints, position=tuple(HOME.tolist()), velocity=(0.0,) * 6
    )
    felt.detection.on_joints("", state)
    assert felt.changes == ["on", "no_effort"]
