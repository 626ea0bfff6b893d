"""The zarm that a bridge stands for: requests to its planner and its executor, and what they publish."""

from __future__ import annotations

from typing import TypeVar

from zarm_contract.errors import ExecutionRefused
from zarm_contract.keys import Keys
from zarm_contract.messages import ExecutorState, JointState, Message, Nothing, Strategies
from zarm_contract.robot import Robot
from zarm_runtime.bus import Bus

ANSWER_SECONDS = 5.0
"""Longest wait for what is answered at once."""

Reply = TypeVar("Reply", bound=Message)


class Engine:
    """One robot's planner and executor. Everything here is safe from any thread, and raises what the services answer.

    Where one is absent that is Unavailable, after the timeout at most.
    """

    def __init__(self, bus: Bus, keys: Keys, robot: Robot) -> None:
        self.bus = bus
        self.keys = keys
        self.robot = robot
        self.joints = robot.descriptor.joints
        self._measured = bus.latest(keys.joint_states, JointState)

    def ask(
        self, key: str, reply: type[Reply], request: Message | None = None, *, timeout: float = ANSWER_SECONDS
    ) -> Reply:
        """The answer to a request."""
        return self.bus.call(key, request or Nothing(), reply, timeout=timeout)

    def measured(self) -> JointState:
        """The robot's joints as measured within the last second. Raises ExecutionRefused (no_joint_state)."""
        state = self._measured.get(max_age=1.0)
        if state is None:
            raise ExecutionRefused(
                f"no joint state of {self.keys.robot} has come for a second; see whether its executor runs (zarm status)",
                code="no_joint_state",
            )
        return state

    def strategies(self) -> Strategies:
        """The active control strategy, and all that this robot knows."""
        return self.ask(self.keys.strategy, Strategies)

    def executor_state(self) -> ExecutorState:
        """What the robot's owner is doing."""
        return self.ask(self.keys.executor_state, ExecutorState)
