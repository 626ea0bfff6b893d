"""The connection with a robot of zarm, and its positions by LeRobot's names."""

from __future__ import annotations

from contextlib import ExitStack

import zarm
from zarm_contract.robot import load_robot


class Link:
    """A robot by its descriptor `robot`; its features are known before it is connected."""

    def __init__(self, robot: str, connect: str | None, name: str | None) -> None:
        self.description = load_robot(robot)
        self._endpoint, self._name = connect, name or self.description.descriptor.name
        self._stack = ExitStack()
        self.connected: zarm.Robot | None = None

    @property
    def joints(self) -> tuple[str, ...]:
        """The names of the joints."""
        return self.description.descriptor.joints

    @property
    def grippers(self) -> tuple[str, ...]:
        """The names of the grippers, sorted as in data sets from records, which have no descriptor."""
        return tuple(sorted(self.description.descriptor.grippers))

    @property
    def features(self) -> dict[str, type]:
        """The names of all positions."""
        return {f"{part}.pos": float for part in (*self.joints, *self.grippers)}

    def open(self) -> None:
        """Connect. Raises zarm.Unavailable without a router."""
        if self.connected is None:
            self.connected = self._stack.enter_context(zarm.connect(self._endpoint, self._name))

    def close(self) -> None:
        """Disconnect."""
        self.connected = None
        self._stack.close()

    @property
    def robot(self) -> zarm.Robot:
        """The robot. Raises ConnectionError before it is connected."""
        if self.connected is None:
            raise ConnectionError(f"{self._name} is not connected; call connect() first")
        return self.connected

    def positions(self) -> dict[str, float]:
        """The measured positions: rad of the joints, m of the grippers."""
        state = self.robot.joint_state()
        found = dict(zip(state.joint_names, state.position, strict=True))
        for gripper in self.grippers:
            found[gripper] = self.robot.gripper.state(gripper).width or 0.0
        return {f"{part}.pos": found[part] for part in (*self.joints, *self.grippers)}
