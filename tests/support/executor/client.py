"""A client of the executor for tests: sends what a user sends, and keeps everything that it receives."""

from __future__ import annotations

import itertools
import time
from typing import Any

import numpy as np

from support.harness import eventually
from support.trajectories import KEYS, ROBOT
from zarm_contract.key import Query
from zarm_contract.keys import Keys
from zarm_contract.messages import (
    CancelRequest,
    ExecuteRequest,
    ExecutorState,
    GoalState,
    JointState,
    SpeedRequest,
    Strategies,
    StrategyRequest,
    Trajectory,
)
from zarm_runtime.bus import Bus
from zarm_trajectory.follower import CATCH_UP
from zarm_trajectory.trajectory import TimedTrajectory

ACCELERATION = np.array(ROBOT.descriptor.cspace.acceleration)


class Client:
    """Answers are returned or raised; `goals`, `states` and `measured` hold what was published since it was created."""

    def __init__(self, bus: Bus, keys: Keys = KEYS) -> None:
        self.bus = bus
        self.keys = keys
        self.goals: list[GoalState] = []
        self.states: list[ExecutorState] = []
        self.measured: list[JointState] = []
        bus.subscribe(keys.goal("*"), lambda _, goal: self.goals.append(goal))
        bus.subscribe(keys.executor_state, lambda _, state: self.states.append(state))
        bus.subscribe(keys.joint_states, lambda _, joints: self.measured.append(joints))

    def execute(
        self,
        trajectory: Trajectory | None = None,
        *,
        plan_id: str | None = None,
        scene_revision: str | None = None,
        preempt: bool = False,
        goal_id: str | None = None,
        replan: bool = False,
    ) -> str:
        request = ExecuteRequest(
            trajectory=trajectory,
            plan_id=plan_id,
            scene_revision=scene_revision,
            preempt=preempt,
            goal_id=goal_id,
            replan=replan,
        )
        return self.bus.call(self.keys.execute, request, timeout=20).goal_id

    def cancel(self, goal_id: str | None = None) -> ExecutorState:
        return self.bus.call(self.keys.cancel, CancelRequest(goal_id=goal_id), timeout=10)

    def command(self, key: Query[Any, ExecutorState]) -> ExecutorState:
        return self.bus.call(key, key.request(), timeout=10)

    def strategy(self, name: str | None = None) -> Strategies:
        return self.bus.call(self.keys.strategy, StrategyRequest(strategy=name), timeout=20)

    def speed(self, scale: float | None = None) -> float:
        request = SpeedRequest(speed_scale=scale)
        return self.bus.call(self.keys.speed, request, timeout=10).speed_scale

    def state(self) -> ExecutorState:
        """The executor's state as a late subscriber reads it."""
        return self.bus.read(self.keys.executor_state, timeout=10)

    def goal(self, goal_id: str) -> GoalState:
        """A goal's state as a late subscriber reads it."""
        return self.bus.read(self.keys.goal(goal_id), timeout=10)

    def ended(self, goal_id: str) -> GoalState:
        """Wait for the goal's end."""

        def last() -> GoalState | None:
            state = self.goal(goal_id)
            return state if state.done else None

        end = eventually(last, f"{goal_id} has ended")
        if self.statuses(goal_id):  # otherwise this client came late
            eventually(lambda: self.statuses(goal_id)[-1] == end.status, f"the end of {goal_id} is told")
        return end

    def under_way(self, goal_id: str, progress: float = 0.3) -> None:
        """Wait until a goal is in the middle of its motion."""
        eventually(lambda: self.goal(goal_id).progress > progress, f"{goal_id} is in motion")

    def mode(self, mode: str) -> ExecutorState:
        """Wait until the executor is in this mode."""

        def reached() -> ExecutorState | None:
            state = self.state()
            return state if state.mode == mode else None

        return eventually(reached, f"the executor is in the mode {mode}")

    def position(self) -> np.ndarray:
        """A position measured after this call."""
        return np.array(self._measured_next(1)[-1].position)

    def statuses(self, goal_id: str) -> list[str]:
        """The statuses that a goal went through, in order."""
        return [
            status for status, _ in itertools.groupby(goal.status for goal in self.goals if goal.goal_id == goal_id)
        ]

    def stands(self, samples: int = 20) -> bool:
        """Whether the robot is at rest, in the same place, in this many states measured after this call."""
        states = self._measured_next(samples)
        return len({state.position for state in states}) == 1 and not any(any(state.velocity) for state in states)

    def _measured_next(self, samples: int) -> list[JointState]:
        """This many joint states measured from now on; earlier ones may still be on their way."""
        now, seen = time.time(), len(self.measured)

        def fresh() -> list[JointState] | None:
            states = [state for state in self.measured[seen:] if state.stamp > now]
            return states if len(states) >= samples else None

        return eventually(fresh, "the joints are measured")

    def greatest_acceleration(self) -> float:
        """Over all measured so far, as a share of the limit; gaps in which the robot was not commanded are skipped."""
        return max(
            float(
                np.max(
                    np.abs(np.subtract(after.velocity, before.velocity)) / (after.stamp - before.stamp) / ACCELERATION
                )
            )
            for before, after in itertools.pairwise(self.measured)
            if after.stamp - before.stamp <= CATCH_UP
        )


def distance_from(path: TimedTrajectory, position: np.ndarray) -> float:
    """How far (rad, the worst joint) a position is from a path."""
    return min(float(np.max(np.abs(path.at(time)[0] - position))) for time in np.linspace(0.0, path.duration, 5000))
