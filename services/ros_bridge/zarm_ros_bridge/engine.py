"""The zarm that a bridge stands for: a client of its planner and its executor, and what they publish."""

from __future__ import annotations

import threading

from zarm.connection import Connection
from zarm.robot import Robot
from zarm_contract.errors import ExecutionRefused
from zarm_contract.keys import Keys
from zarm_contract.messages import JointState
from zarm_contract.robot import RobotDescription
from zarm_ros_bridge.terms import Terms, Translated
from zarm_runtime.bus import Bus


class Engine:
    """One robot's planner and executor. Everything here is safe from any thread, and raises what the services answer, in `terms`.

    Where one is absent that is Unavailable, after the timeout at most.
    """

    def __init__(self, bus: Bus, keys: Keys, robot: RobotDescription, terms: Terms) -> None:
        self.bus = bus
        self.keys = keys
        self.robot = robot
        self.terms = terms
        self.joints = robot.descriptor.joints
        self.client = Robot(Connection.of(bus, keys, Translated(terms)))
        self.ending = threading.Event()
        """Set when the bridge ends: whoever waits for what the executor tells gives up."""
        self._measured = bus.latest(keys.joint_states, JointState)

    def measured(self) -> JointState:
        """The robot's joints as measured within the last second. Raises ExecutionRefused (no_joint_state)."""
        state = self._measured.get(max_age=1.0)
        if state is None:
            raise ExecutionRefused(
                f"no joint state of {self.keys.robot} has come for a second; see whether its executor runs (zarm status)",
                code="no_joint_state",
            )
        return state
