"""A robot of zarm as LeRobot knows robots."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any

from lerobot.cameras.utils import make_cameras_from_configs
from lerobot.robots import Robot

import zarm
from lerobot_robot_zarm.config import ZarmConfig
from lerobot_robot_zarm.link import Link
from zarm_contract.messages import GripperRequest

_ANSWER = 2.0
"""Longest wait (s) for the answer to a command of a gripper."""
_CHANGE = 0.001
"""A gripper is commanded when its opening has changed by this much (m)."""


class Zarm(Robot):
    """Follows actions by zarm's servo, see the README."""

    config_class = ZarmConfig
    name = "zarm"

    def __init__(self, config: ZarmConfig) -> None:
        super().__init__(config)
        self.config = config
        self._link = Link(config.robot, config.connect, config.name)
        self.cameras = make_cameras_from_configs(config.cameras)
        self._session = ExitStack()
        self._tracking: zarm.Tracking | None = None
        self._opened: dict[str, float] = {}

    @property
    def observation_features(self) -> dict[str, Any]:
        """`<joint>.pos` (rad), `<gripper>.pos` (m), and the shape of each camera's images."""
        images = {name: (camera.height, camera.width, 3) for name, camera in self.config.cameras.items()}
        return {**self._link.features, **images}

    @property
    def action_features(self) -> dict[str, Any]:
        """`<joint>.pos` (rad) and `<gripper>.pos` (m)."""
        return dict(self._link.features)

    @property
    def is_connected(self) -> bool:
        """Whether the robot and its cameras are connected."""
        return self._link.connected is not None and all(camera.is_connected for camera in self.cameras.values())

    def connect(self, calibrate: bool = True) -> None:
        """Connect with robot and cameras; nothing moves."""
        self._link.open()
        for camera in self.cameras.values():
            camera.connect()

    @property
    def is_calibrated(self) -> bool:
        """Always: positions are those of the robot's encoders."""
        return True

    def calibrate(self) -> None:
        """Nothing is to be done."""

    def configure(self) -> None:
        """Nothing is to be done."""

    def get_observation(self) -> dict[str, Any]:
        """The measured positions and the newest images."""
        return {**self._link.positions(), **{name: camera.async_read() for name, camera in self.cameras.items()}}

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Follow these positions, moved into the limits; returns what was sent. Raises zarm.Cancelled once somebody has stopped the robot."""
        sent = self._inside(action)
        if self.config.operated:
            return sent
        self._session_to_lead().to([sent[f"{joint}.pos"] for joint in self._link.joints])
        for gripper in self._link.grippers:
            self._move(gripper, sent[f"{gripper}.pos"])
        return sent

    def disconnect(self) -> None:
        """Bring the robot to rest, and disconnect."""
        try:
            self._session.close()
        finally:
            self._tracking = None
            for camera in self.cameras.values():
                camera.disconnect()
            self._link.close()

    def _inside(self, action: dict[str, Any]) -> dict[str, float]:
        description = self._link.description
        bounds = dict(zip(self._link.joints, zip(description.lower, description.upper, strict=True), strict=True))
        bounds |= {name: (gripper.closed, gripper.open) for name, gripper in description.descriptor.grippers.items()}
        found = {}
        for part, (lower, upper) in bounds.items():
            key = f"{part}.pos"
            if key not in action:
                raise zarm.InvalidRequest(
                    f"the action has no {key}; it needs each of {', '.join(self.action_features)}", field=key
                )
            found[key] = min(max(float(action[key]), lower), upper)
        return found

    def _session_to_lead(self) -> zarm.Tracking:
        """The open session of the servo, or a new one where none is, or the last was ended by a pause of the policy."""
        if self._tracking is None or not self._tracking.running:
            self._session.close()  # raises why it has ended
            config = self.config
            self._tracking = self._session.enter_context(
                self._link.robot.track(
                    margin=config.margin,
                    velocity_scale=config.velocity_scale,
                    acceleration_scale=config.acceleration_scale,
                )
            )
        return self._tracking

    def _move(self, gripper: str, opening: float) -> None:
        if abs(self._opened.get(gripper, -1.0) - opening) >= _CHANGE:
            connection = self._link.robot.connection
            request = GripperRequest(gripper=gripper, width=opening, preempt=True)
            connection.ask(connection.keys.gripper, request, timeout=_ANSWER)
            self._opened[gripper] = opening
