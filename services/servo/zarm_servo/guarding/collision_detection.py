"""What pushes the robot: the efforts of its joints, less what its motion needs."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from zarm_contract.errors import Unavailable
from zarm_contract.messages import (
    Attached,
    CollisionDetectionState,
    ExecutorState,
    ExternalTorque,
    JointState,
    Nothing,
)
from zarm_contract.messages import JointDynamics as JointDynamicsMessage
from zarm_geometry.dynamics import Dynamics
from zarm_geometry.robot_model import RobotModel
from zarm_runtime import clock
from zarm_servo.guarding.joint_dynamics import Identification, Moving, unexplained
from zarm_servo.world.scene_monitor import SceneMonitor
from zarm_trajectory.arrays import Array

log = logging.getLogger(__name__)


_SPAN = 0.02
"""Time (s) over which efforts are compared with the change of momentum: less is noise, more is late."""
_MAX_INTERVAL = 0.1
"""Joint states further apart than this (s) are not compared: between them, anything may have happened."""
_PERIOD = 0.1
"""Interval (s) at which the torque is published while nothing happens."""


class _Sample(NamedTuple):
    stamp: float
    position: Array
    velocity: Array
    effort: Array


class CollisionDetection:
    """Watches the joint states of the driver. Messages of one kind come one at a time.

    The torque from outside is that of the inverse dynamics, with everything that the robot carries, and of the friction and the motors that the descriptor states, less the measured effort; the
    acceleration is the change of the measured velocity over `_SPAN`, as in a momentum observer (De Luca and Mattone, 2003). What it does not state counts as
    torque from outside; `identification` finds it.
    `changed` is called when `state` has changed.
    """

    def __init__(
        self,
        model: RobotModel,
        scene: SceneMonitor,
        publish: Callable[[ExternalTorque], object],
        changed: Callable[[], object],
    ) -> None:
        self._model, self._scene, self._publish, self._changed = model, scene, publish, changed
        descriptor = model.robot.descriptor
        self._joints = descriptor.joints
        limits = descriptor.execution.external_torque_limits
        self._limits = None if limits is None else np.array(limits)
        self.identification = Identification(self._joints)
        self._attached: tuple[Attached, ...] = ()
        self._dynamics: Dynamics | None = model.dynamics
        self._samples: deque[_Sample] = deque()
        self._largest: Array = np.zeros(len(self._joints))
        self._goal_id: str | None = None
        self._felt_in: str | None = None
        self._published = 0.0
        self._measured = False

    @property
    def state(self) -> CollisionDetectionState:
        """Whether collisions are detected, and if not, why."""
        if self._limits is None:
            return "off"
        if self._dynamics is None:
            return "no_inertia"
        return "on" if self._measured else "no_effort"

    def on_state(self, state: ExecutorState) -> None:
        """Note which goal runs."""
        if state.goal_id is not None and state.goal_id != self._goal_id:
            self._largest = np.zeros(len(self._joints))
        self._goal_id = state.goal_id

    def on_joints(self, _key: str, message: JointState) -> None:
        """Take a joint state of the driver."""
        sample = self._sample(message)
        if (sample is not None) != self._measured:
            self._measured = sample is not None
            self._changed()
        if sample is None:
            return
        samples = self._samples
        if samples and not 0.0 < sample.stamp - samples[-1].stamp <= _MAX_INTERVAL:
            samples.clear()
        samples.append(sample)
        while len(samples) > 2 and sample.stamp - samples[1].stamp >= 0.99 * _SPAN:  # stamps are rounded
            samples.popleft()
        dynamics = self._present_dynamics()
        if dynamics is not None and len(samples) > 1:
            self._judge(self._external(dynamics, samples), sample.stamp)

    def identify(self, _: Nothing) -> JointDynamicsMessage:
        """The joint dynamics in the motions so far. Raises Unavailable if there were too few, or without efforts or inertia."""
        if self._dynamics is None:
            raise Unavailable(
                "the URDF does not state the inertia of each link, without which friction cannot be identified; add it"
            )
        if not self._measured:
            raise Unavailable(
                "the driver reports no efforts, without which friction cannot be identified; configure it to report torques"
            )
        return self.identification.found()

    def _sample(self, message: JointState) -> _Sample | None:
        """The joints in the descriptor's order; None without efforts, or if one is missing."""
        names = message.joint_names
        if message.effort is None or not set(self._joints) <= set(names):
            return None
        order = [names.index(joint) for joint in self._joints]
        position, velocity, effort = np.array((message.position, message.velocity, message.effort))[:, order]
        return _Sample(message.stamp, position, velocity, effort)

    def _present_dynamics(self) -> Dynamics | None:
        attached = self._scene.snapshot(clock.monotonic()).attached
        if attached != self._attached:
            self._attached = attached
            self._dynamics = self._model.with_attached(attached, ()).dynamics
            self._samples.clear()
        return self._dynamics

    def _external(self, dynamics: Dynamics, samples: deque[_Sample]) -> Array:
        """The torque (dof,) from outside, a mean over the samples."""
        first, last = samples[0], samples[-1]
        acceleration = (last.velocity - first.velocity) / (last.stamp - first.stamp)
        position, velocity = 0.5 * (first.position + last.position), 0.5 * (first.velocity + last.velocity)
        needed: Array = dynamics.of_links().torque(position[None], velocity[None], acceleration[None])[0]
        exerted = sum(sample.effort for sample in list(samples)[1:]) / (len(samples) - 1)
        moving, excess = Moving.over(np.array([sample.velocity for sample in samples]), acceleration), exerted - needed
        if self._goal_id is not None:
            self.identification.add(moving, excess)
        return -unexplained(dynamics.joints, excess, moving)

    def _judge(self, torque: Array, stamp: float) -> None:
        self._largest = np.maximum(self._largest, np.abs(torque))
        joint, goal_id = None, self._goal_id
        if self._limits is not None and goal_id is not None:
            excess = np.abs(torque) / self._limits
            worst = int(excess.argmax())
            if excess[worst] > 1.0:
                joint = self._joints[worst]
                self._note(goal_id, joint, float(torque[worst]))
        if joint is not None or not 0.0 <= stamp - self._published < _PERIOD:
            self._published = stamp
            self._publish(
                ExternalTorque(
                    stamp=stamp,
                    joint_names=self._joints,
                    torque=tuple(torque.tolist()),
                    largest=tuple(self._largest.tolist()),
                    goal_id=goal_id,
                    joint=joint,
                )
            )

    def _note(self, goal_id: str, joint: str, torque: float) -> None:
        if goal_id != self._felt_in:
            log.warning("a collision is felt goal_id=%s joint=%s torque=%.1f", goal_id, joint, torque)
        self._felt_in = goal_id
