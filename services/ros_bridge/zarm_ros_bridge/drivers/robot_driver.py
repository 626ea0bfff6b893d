"""Connects the ROS topics of a robot's driver to the keys `driver/*` on the bus."""

from __future__ import annotations

import logging
import math
import threading
import time
from typing import Any

from rclpy.event_handler import PublisherEventCallbacks
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState as RosJointState
from std_msgs.msg import Float32, Float64
from trajectory_msgs.msg import JointTrajectory

from zarm_contract.descriptor import StrategyParams
from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import DriverCommand, DriverProgress, DriverSpeed, ExecutorState
from zarm_ros_bridge.answers import shortened
from zarm_ros_bridge.convert.trajectories import ros_joint_trajectory
from zarm_ros_bridge.drivers.controller_action import ControllerAction
from zarm_ros_bridge.drivers.gripper_driver import GripperDriver
from zarm_ros_bridge.drivers.joints import DriverJointStates
from zarm_ros_bridge.drivers.output_driver import OutputDriver
from zarm_ros_bridge.drivers.progress import ProgressReader
from zarm_ros_bridge.drivers.standing import Standing
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.ros import Ros
from zarm_runtime.expiry import Expiry

log = logging.getLogger(__name__)

COMMAND_DEPTH = 10
"""Commands that may wait for a driver, as in the reference."""

_SPEED_PERIOD = 1.0
"""How often (s) a speed that does not change is passed on."""


class Drivers:
    """Carries commands out (reliable) unless they are late, and joint states and progress in; topics are those of
    `params`.

    While a robot stands, joint states are forwarded at the rate of `Standing`.

    Whole trajectories go to the controller's action, if it has one: `controller` is the participant for that. Where nobody serves the
    action, but somebody listens to the topic, they go there. Commands to grippers go to the actions of their controllers, and those
    to outputs to services.

    Unreadable driver messages are dropped; each kind of fault is logged once. The executor then hears nothing, and
    stops the robot. A driver may start late, leave, and return. DDS discovers each direction separately: joint states
    may arrive before commands can be sent, so every change in who listens to commands is logged.
    """

    def __init__(self, ros: Ros, controller: Ros | None, engine: Engine, params: StrategyParams) -> None:
        keys = engine.keys
        self._action = (
            None
            if controller is None or params.action is None
            else ControllerAction(controller, params.action, self._give_up)
        )
        self._scale, self._scaled_at = 1.0, 0.0
        self._whole = False  # whether commands are whole trajectories, which the action takes
        if self._action is not None:
            engine.bus.watch(keys.executor_state, self._on_state)
        grippers = engine.robot.descriptor.grippers
        self._reports = DriverJointStates(
            params.joint_states_order or engine.joints,
            engine.joints,
            [gripper.joint for gripper in grippers.values()],
        )
        self._grippers = [
            GripperDriver(controller, engine, name, gripper.action)
            for name, gripper in grippers.items()
            if gripper.action is not None and controller is not None
        ]
        self._outputs = [
            OutputDriver(controller, engine, name, output.service, output.driver_timeout)
            for name, output in engine.robot.descriptor.outputs.items()
            if output.service is not None and controller is not None
        ]
        self._topic = params.joint_states_topic
        self._complaints: set[str] = set()
        self._progress = ProgressReader()
        self._expiry = Expiry()
        self._standing = Standing(engine.robot.descriptor.execution.joint_state_timeout)
        self._hurry = ros.hurry
        self._turn = threading.Lock()  # commands come in a thread of the bus, progress in one of ROS
        self._states = engine.bus.publisher(keys.driver_joint_states)
        self._played = engine.bus.publisher(keys.driver_progress)
        self._commands = ros.node.create_publisher(
            JointTrajectory,
            params.command_topic,
            COMMAND_DEPTH,
            event_callbacks=PublisherEventCallbacks(matched=self._matched),
        )
        ros.listen(RosJointState, params.joint_states_topic, self._joint_states, qos_profile_sensor_data, raw=True)
        if params.state_topic is not None:
            ros.listen(Float32, params.state_topic, self._state, COMMAND_DEPTH)
        if params.speed_scaling_topic is not None:
            self._speed = engine.bus.publisher(keys.driver_speed)
            ros.listen(Float64, params.speed_scaling_topic, self._speed_scaling, COMMAND_DEPTH)
        engine.bus.subscribe_timed(keys.driver_command, self._command)

    def _command(self, command: DriverCommand, arrived: float) -> None:
        if not self._expiry.in_time(command, arrived):
            log.warning("dropped a late command sequence=%d points=%d", command.sequence, len(command.time))
            return
        message = ros_joint_trajectory(command)
        with self._turn:
            self._progress.sent(command.sequence, len(command.time))
            if self._action is None or not self._whole:
                self._commands.publish(message)
            elif not command.time:  # whatever it is that plays
                self._action.stop(command.sequence)
                self._commands.publish(message)
            elif self._action.is_served() or not self._commands.get_subscription_count():
                self._action.play(command.sequence, message)
            else:
                self._commands.publish(message)
        self._hurry()

    def _on_state(self, _: str, state: ExecutorState) -> None:
        self._whole = state.strategy == "joint_trajectory"

    def _give_up(self, sequence: int, reason: str) -> None:
        log.warning("the controller gave up sequence=%d reason=%s", sequence, reason.replace("\n", " "))
        self._played.put(DriverProgress(sequence=sequence, fraction=0.0, problem=shortened(reason)))

    def _matched(self, listeners: Any) -> None:
        change = "come" if listeners.current_count_change > 0 else "gone"
        log.info("a driver has %s topic=%s listeners=%d", change, self._commands.topic_name, listeners.current_count)

    def _joint_states(self, message: bytes) -> float | None:
        """How long (s) the next ones may wait."""
        try:
            state = self._reports.read(message)
        except InvalidRequest as error:
            self._complain(f"{error.problem.field}: {error.problem.message}")
            return None
        now = time.monotonic()
        self._expiry.report(state.stamp, now)
        if self._standing.passes(state, now):
            self._states.put(state)
        return self._standing.pause

    def _state(self, message: Float32) -> None:
        if not math.isfinite(message.data):
            self._complain(f"progress: {message.data} is not a number from 0 to 1")
            return
        with self._turn:
            progress = self._progress.read(message.data)
        if progress is not None:
            self._played.put(progress)

    def _speed_scaling(self, message: Float64) -> None:
        """A percentage; passed on when it changes, and now and then for an executor that starts later."""
        if not math.isfinite(message.data):
            self._complain(f"speed scaling: {message.data} is not a percentage")
            return
        scale, now = min(max(message.data / 100.0, 0.0), 1.0), time.monotonic()
        if scale == self._scale and now - self._scaled_at < _SPEED_PERIOD:
            return
        self._scale, self._scaled_at = scale, now
        self._speed.put(DriverSpeed(scale=scale))

    def _complain(self, fault: str) -> None:
        if fault not in self._complaints and len(self._complaints) < 100:
            self._complaints.add(fault)
            log.warning(
                "the driver cannot be read topic=%s reason=%s", self._topic, shortened(fault.replace("\n", " "))
            )
