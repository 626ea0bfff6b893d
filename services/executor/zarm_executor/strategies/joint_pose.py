"""The strategy that streams positions, for drivers without a velocity interface."""

from __future__ import annotations

from zarm_executor.strategies.driver_link import DriverLink
from zarm_executor.strategies.streaming import Streaming
from zarm_trajectory.retimed import RetimedTrajectory


class JointPose(Streaming):
    """Sends chunks of positions; the driver closes the loop."""

    name = "joint_pose"
    link: DriverLink

    def _send(self, ahead: RetimedTrajectory, now: float, played: int) -> bool:
        self.link.send(ahead.points, positions_only=True)
        return bool((ahead.points.position == ahead.points.position[0]).all())
