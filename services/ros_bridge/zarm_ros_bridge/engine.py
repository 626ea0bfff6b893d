"""The robot behind a bridge: a client of its planner and executor, and their publications."""

from __future__ import annotations

import threading

from zarm.connection import Connection
from zarm.robot import Robot
from zarm_contract.keys import Keys
from zarm_contract.messages import ExecutorState, GoalState, Scene
from zarm_contract.robot import RobotDescription
from zarm_ros_bridge.terms import Terms, Translated
from zarm_runtime.bus import Bus


class Engine:
    """One robot's planner and executor. Everything here is thread-safe, and raises the services' errors, in `terms`.

    If a service is absent, the error is Unavailable, at the latest after the timeout.
    """

    def __init__(self, bus: Bus, keys: Keys, robot: RobotDescription, terms: Terms) -> None:
        self.bus = bus
        self.keys = keys
        self.robot = robot
        self.terms = terms
        self.joints = robot.descriptor.joints
        self.client = Robot(Connection.of(bus, keys, Translated(terms)))
        self.ending = threading.Event()
        """Set when the bridge ends: anything that waits for the executor gives up."""
        self._tools: tuple[str, ...] = ()
        if robot.descriptor.tools:
            bus.watch(keys.scene, self._on_scene)

    @property
    def tooled(self) -> RobotDescription:
        """The robot with the tools that are mounted now."""
        return self.robot.with_tools(self._tools)

    def goal(self, state: ExecutorState) -> GoalState | None:
        """The goal that has not ended in this state, as last reported by its executor."""
        return None if state.goal_id is None else self.client.connection.goals.known(state.goal_id)

    def _on_scene(self, _key: str, scene: Scene) -> None:
        self._tools = scene.tools
