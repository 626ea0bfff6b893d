"""What a record contains: the recorded keys of a robot, and the message class of each."""

from __future__ import annotations

from zarm_contract.keys import Keys
from zarm_contract.messages import (
    Authority,
    DriverCommand,
    DriverProgress,
    ExecutorState,
    GoalState,
    JointState,
    Message,
    Plan,
    SceneEdited,
    ServoState,
    Speed,
    Strategies,
    StreamChunk,
)


class Recorded:
    """The recorded keys of one robot. The preview and the trajectories of goals are left out: they follow from plans
    and streams.

    `models` are the classes by key expression (goals are the family `executor/goal/*`); `present` are the keys that
    answer with their present value, so that a record can begin with the values that held before.
    """

    def __init__(self, keys: Keys) -> None:
        self.models: dict[str, type[Message]] = {
            keys.plans: Plan,
            keys.scene_revision: SceneEdited,
            keys.executor_state: ExecutorState,
            keys.goal("*"): GoalState,
            keys.authority: Authority,
            keys.servo_state: ServoState,
            keys.strategy: Strategies,
            keys.speed: Speed,
            keys.stream: StreamChunk,
            keys.joint_states: JointState,
            keys.driver_command: DriverCommand,
            keys.driver_progress: DriverProgress,
            keys.driver_joint_states: JointState,
        }
        self.present = frozenset((keys.plans, keys.scene_revision, keys.executor_state, keys.strategy, keys.speed))
        self._goals = keys.goal("*")
        self._goal = self._goals.removesuffix("*")

    def model(self, key: str) -> type[Message] | None:
        """The class of the messages on `key`; None if the key is not recorded."""
        return self.models.get(self._goals if key.startswith(self._goal) else key)
