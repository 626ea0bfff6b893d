"""Clients of MoveIt Servo, as pymoveit2 makes them, jog the robot."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from pymoveit2 import MoveIt2Servo
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node

from support.harness import PATIENCE, eventually
from support.ros.stack import KEYS, Stack
from zarm.connection import Connection
from zarm.robot import Robot


def sends() -> bool:
    """Whether a client sends now: it pauses for one second in six, as one must whose session could not begin."""
    return time.monotonic() % 6.0 < 5.0


@pytest.mark.parametrize("legacy", [False, True], ids=["jazzy", "humble"])
def test_twists_and_joint_jogs_move_the_robot_until_it_is_paused(
    arm: Stack, client: Node, group: ReentrantCallbackGroup, legacy: bool, tmp_path: Path
) -> None:
    robot = Robot(Connection.of(arm.bus, KEYS))
    servo = MoveIt2Servo(
        node=client, frame_id="base_link", callback_group=group, enable_at_init=False, legacy_interface=legacy
    )

    def enabled() -> bool:
        servo.enable()
        return servo.wait_until_ready(timeout_sec=1.0)

    eventually(enabled, "the servo is enabled")
    above = robot.tip().position[2]

    def raised() -> bool:
        if sends():
            servo.servo(linear=(0.0, 0.0, 0.05), angular=(0.0, 0.0, 0.0))
        return robot.tip().position[2] > above + 0.02

    eventually(raised, "the tip rises")
    turned = robot.joint_state().position[0]

    def jogged() -> bool:
        if sends():
            servo.servo_jog(["joint_1"], velocities=[0.2])
        return robot.joint_state().position[0] > turned + 0.03

    eventually(jogged, "joint_1 turns")
    assert servo.disable(sync=True)
    eventually(lambda: robot.state().goal_id is None, "it rests")
    rest = robot.joint_state().position
    for _ in range(20):
        servo.servo_jog(["joint_1"], velocities=[0.2])
    assert np.allclose(robot.joint_state().position, rest, atol=1e-4)
    servo.shutdown(PATIENCE)
