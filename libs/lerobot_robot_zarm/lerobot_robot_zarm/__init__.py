"""Robots that zarm moves, for LeRobot."""

from lerobot_robot_zarm.camera import ZarmCamera
from lerobot_robot_zarm.config import ZarmCameraConfig, ZarmConfig, ZarmTeleopConfig
from lerobot_robot_zarm.robot import Zarm
from lerobot_robot_zarm.teleoperator import ZarmTeleop

__all__ = ["Zarm", "ZarmCamera", "ZarmCameraConfig", "ZarmConfig", "ZarmTeleop", "ZarmTeleopConfig"]
