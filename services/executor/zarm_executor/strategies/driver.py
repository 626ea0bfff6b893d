"""What all strategies have in common that move a robot through its driver."""

from __future__ import annotations

from zarm_contract.errors import Unavailable
from zarm_executor.strategies.base import Measured, Strategy
from zarm_executor.strategies.driver_link import DriverLink


class DriverStrategy(Strategy):
    """Reads the robot through a link. It opens only where the driver tells the robot's joints, and stops it first."""

    def __init__(self, link: DriverLink) -> None:
        self.link = link

    def obstacle(self) -> str | None:
        """No driver, or one that is silent."""
        return self.link.obstacle()

    def open(self) -> None:
        """Have the driver drop whatever somebody else left it to play."""
        reason = self.obstacle()
        if reason is not None:
            raise Unavailable(reason)
        self.link.stop()

    def close(self) -> None:
        """The robot rests; its driver goes on telling where."""

    def admit(self) -> None:
        """Whether the joints are fresh is checked before every motion, whatever the strategy."""

    def joint_state(self) -> Measured | None:
        """What the driver told last."""
        return self.link.measured()
