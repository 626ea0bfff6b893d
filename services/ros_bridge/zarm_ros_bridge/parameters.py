"""The parameters of the node: what they may be, and what they are."""

from __future__ import annotations

from typing import Any

from rclpy.node import Node

from zarm_ros_bridge.engine import Engine


class Parameters:
    """Declares every parameter on `node`. A value that cannot be is refused with the reason, and nothing changes."""

    def __init__(self, node: Node, engine: Engine) -> None:
        self._node = node
        self._engine = engine

    def value(self, name: str) -> Any:
        """The present value."""
        return self._node.get_parameter(name).value
