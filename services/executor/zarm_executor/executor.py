"""What clients can ask of the executor, one method for each query."""

from __future__ import annotations

import secrets
import threading
import time

from zarm_contract.bus import Publisher
from zarm_contract.errors import Busy, ZarmError
from zarm_contract.messages import (
    Accepted,
    CancelRequest,
    ExecuteRequest,
    ExecutorState,
    GoalState,
    Nothing,
    Strategies,
    StrategyRequest,
)
from zarm_contract.robot import Robot
from zarm_executor.checks import executable, startable
from zarm_executor.machine import Goal, Machine
from zarm_executor.monitor import Monitor
from zarm_executor.plans import Plans
from zarm_executor.reporter import Reporter
from zarm_executor.strategies.repertoire import Repertoire

REST_PATIENCE = 10.0
"""Longest wait, s, for a moving robot to come to rest; a robot needs about its velocity over its acceleration limit."""


class Executor:
    """Answers the queries. Every ZarmError it raises is the answer, and then nothing has moved that did not move before."""

    def __init__(
        self,
        robot: Robot,
        machine: Machine,
        reporter: Reporter,
        plans: Plans,
        strategies: Repertoire,
        publisher: Publisher[Strategies],
    ) -> None:
        self._robot = robot
        self._machine = machine
        self._reporter = reporter
        self._plans = plans
        self._strategies = strategies
        self._publisher = publisher
        self._checking = threading.Lock()

    def execute(self, request: ExecuteRequest) -> Accepted:
        """Check a motion and start it. One at a time: what waited here would start after a stop that came meanwhile."""
        if not self._checking.acquire(blocking=False):
            raise Busy("another motion is being checked; execute again when it has ended or been refused")
        try:
            stops = self._machine.stops
            self._machine.admit()
            plan_id, trajectory = self._plans.chosen(request)
            path = executable(trajectory, self._robot)
            path = startable(path, self._machine.joint_state(), time.monotonic(), self._robot)
            monitor = Monitor(path, self._robot.descriptor.joints, self._robot.descriptor.execution)
            goal = Goal(f"goal-{secrets.token_hex(4)}", plan_id, path, monitor)
            self._reporter.remember(
                GoalState(
                    goal_id=goal.goal_id,
                    plan_id=plan_id,
                    status="accepted",
                    progress=0.0,
                    elapsed=0.0,
                    duration=path.duration,
                    joint_command=tuple(path.start.tolist()),
                )
            )
            try:
                self._machine.start(goal, stops)
            except ZarmError:
                self._reporter.forget()
                raise
            self._reporter.publish()
            return Accepted(goal_id=goal.goal_id)
        finally:
            self._checking.release()

    def check_idle(self) -> None:
        """Raises Busy unless the robot rests and nothing is wrong."""
        mode = self._machine.state().mode
        if mode != "idle":
            raise Busy(f"the executor is in the mode {mode}; let the goal end, or reset what is wrong, and ask again")

    def cancel(self, request: CancelRequest) -> ExecutorState:
        """Cancel one goal, or the one that runs."""
        self._machine.cancel(request.goal_id, "the goal was cancelled by a client")
        return self._reporter.publish()

    def stop(self, _: Nothing) -> ExecutorState:
        """Bring the robot to rest."""
        self._machine.cancel(None, "the robot was stopped by a client")
        return self._reporter.publish()

    def pause(self, _: Nothing) -> ExecutorState:
        """Hold the goal that runs."""
        self._machine.pause()
        return self._reporter.publish()

    def resume(self, _: Nothing) -> ExecutorState:
        """Go on with the goal that is held."""
        self._machine.resume()
        return self._reporter.publish()

    def reset(self, _: Nothing) -> ExecutorState:
        """Leave `fault`."""
        self._machine.reset()
        return self._reporter.publish()

    def strategy(self, request: StrategyRequest) -> Strategies:
        """Read which strategy is active, or switch to another."""
        name = request.strategy
        if name is None or name == self._machine.state().strategy:
            return self._describe_strategies()
        self._machine.switch(self._strategies.find(name), REST_PATIENCE)
        self._reporter.publish()
        return self.publish_strategies()

    def publish_strategies(self) -> Strategies:
        """Publish which strategy is active."""
        strategies = self._describe_strategies()
        self._publisher.put(strategies)
        return strategies

    def _describe_strategies(self) -> Strategies:
        return Strategies(
            active=self._machine.state().strategy,
            strategies=self._strategies.describe(),
        )
