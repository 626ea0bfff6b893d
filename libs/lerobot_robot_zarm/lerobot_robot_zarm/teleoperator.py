"""What a robot of zarm does, as actions: somebody moves it by the page, `zarm jog` or a pendant."""

from __future__ import annotations

from typing import Any

from lerobot.teleoperators import Teleoperator

from lerobot_robot_zarm.config import ZarmTeleopConfig
from lerobot_robot_zarm.link import Link


class ZarmTeleop(Teleoperator):
    """The positions of a robot that is operated."""

    config_class = ZarmTeleopConfig
    name = "zarm"

    def __init__(self, config: ZarmTeleopConfig) -> None:
        super().__init__(config)
        self._link = Link(config.robot, config.connect, config.name)

    @property
    def action_features(self) -> dict[str, type]:
        """`<joint>.pos` (rad) and `<gripper>.pos` (m)."""
        return self._link.features

    @property
    def feedback_features(self) -> dict[str, type]:
        """None."""
        return {}

    @property
    def is_connected(self) -> bool:
        """Whether the robot is connected."""
        return self._link.connected is not None

    def connect(self, calibrate: bool = True) -> None:
        """Connect with the robot."""
        self._link.open()

    @property
    def is_calibrated(self) -> bool:
        """Always."""
        return True

    def calibrate(self) -> None:
        """Nothing is to be done."""

    def configure(self) -> None:
        """Nothing is to be done."""

    def get_action(self) -> dict[str, Any]:
        """The measured positions."""
        return self._link.positions()

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """There is nothing to feel."""

    def disconnect(self) -> None:
        """Disconnect."""
        self._link.close()
