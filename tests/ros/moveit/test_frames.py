"""The bridge publishes the robot's frames on /tf, and steps back where another node does."""

from __future__ import annotations

import numpy as np
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from tf2_msgs.msg import TFMessage

import zarm
from support.harness import eventually
from support.ros.stack import KEYS, Stack
from zarm.connection import Connection
from zarm.robot import Robot
from zarm_contract.robot import load_robot

ROBOT = load_robot("doosan_m1013")
HOME, TIP = ROBOT.descriptor.home, ROBOT.descriptor.tip_link
LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def chained(messages: list[TFMessage], frame: str) -> np.ndarray:
    """The pose (4, 4) of a frame at the root of the last transforms."""
    from zarm_geometry.frames import matrix

    last = {one.child_frame_id: one for message in messages for one in message.transforms}
    pose = np.eye(4)
    while (one := last.get(frame)) is not None:
        t, r = one.transform.translation, one.transform.rotation
        pose = matrix((t.x, t.y, t.z), (r.x, r.y, r.z, r.w)) @ pose
        frame = one.header.frame_id
    return pose


def test_the_frames_of_the_robot_and_of_objects_are_on_tf(arm: Stack) -> None:
    robot = Robot(Connection.of(arm.bus, KEYS))
    robot.scene.add(zarm.Cuboid("crate", size=(0.1, 0.1, 0.1), position=(0.9, 0.7, 0.3)), replace=True)
    robot.execute(robot.plan(HOME))
    (tip,) = robot.fk([HOME])
    moving = arm.ros.heard(TFMessage, "/tf")
    fixed = arm.ros.heard(TFMessage, "/tf_static", LATCHED)
    eventually(lambda: moving, "the frames are published")
    assert np.allclose(chained([*fixed, *moving], TIP)[:3, 3], tip.position, atol=1e-4)
    assert np.allclose(chained([*fixed, *moving], "crate")[:3, 3], (0.9, 0.7, 0.3))
    robot.scene.remove("crate")


def test_the_bridge_publishes_no_frames_while_another_node_does(arm: Stack, node: Node) -> None:
    heard = arm.ros.heard(TFMessage, "/tf")
    publisher = node.create_publisher(TFMessage, "/tf", 100)
    mine = TFMessage(transforms=eventually(lambda: heard, "the bridge publishes")[0].transforms)

    def silent() -> bool:
        for one in mine.transforms:
            one.header.stamp = node.get_clock().now().to_msg()
            one.header.stamp.nanosec = one.header.stamp.nanosec // 10 * 10 + 7
        publisher.publish(mine)
        others = [one for message in heard[-20:] for one in message.transforms if one.header.stamp.nanosec % 10 != 7]
        return len(heard) > 20 and not others

    eventually(silent, "the bridge is silent")
    node.destroy_publisher(publisher)
    count = len(heard)
    eventually(lambda: len(heard) > count + 5, "it publishes again")
