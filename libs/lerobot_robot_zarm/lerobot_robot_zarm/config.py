"""What LeRobot's command line and files say about a robot of zarm."""

from __future__ import annotations

from dataclasses import dataclass, field

from lerobot.cameras import CameraConfig
from lerobot.robots import RobotConfig
from lerobot.teleoperators import TeleoperatorConfig


@RobotConfig.register_subclass("zarm")
@dataclass(kw_only=True)
class ZarmConfig(RobotConfig):
    """A robot on the bus of zarm: its descriptor, by name or file, and how it is moved; see the README."""

    robot: str = "doosan_m1013"
    connect: str | None = None
    name: str | None = None
    operated: bool = False
    margin: float = 0.01
    velocity_scale: float = 1.0
    acceleration_scale: float = 1.0
    cameras: dict[str, CameraConfig] = field(default_factory=dict)


@CameraConfig.register_subclass("zarm")
@dataclass(kw_only=True)
class ZarmCameraConfig(CameraConfig):
    """A camera by its name on the bus of zarm, and the robot's name there."""

    camera: str
    connect: str | None = None
    name: str | None = None


@TeleoperatorConfig.register_subclass("zarm")
@dataclass(kw_only=True)
class ZarmTeleopConfig(TeleoperatorConfig):
    """A robot on the bus of zarm that somebody else moves."""

    robot: str = "doosan_m1013"
    connect: str | None = None
    name: str | None = None
