"""Planner and executor of a robot inside a policy."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from zarm.connection import Connection
from zarm.executor import Executor
from zarm.gripper import Gripper
from zarm.planner import Planner
from zarm.scene import Scene
from zarm_contract.errors import Busy, Cancelled, InvalidRequest
from zarm_contract.messages import ExecuteRequest, ExecutorState, GoalState, Plan, Segment, Trajectory
from zarm_mcp.policy import Policy
from zarm_mcp.policy_check import PolicyCheck
from zarm_mcp.twin import Twin

_SLOWDOWNS = 6
"""A plan is made again so often, slower, until it is inside the policy's speeds."""
_SLOWEST = 0.01
_SPARE = 0.95


class GuardedPlanner(Planner):
    """Makes plans that are inside the speeds of a policy."""

    def __init__(self, connection: Connection, policy: Policy, check: PolicyCheck) -> None:
        super().__init__(connection)
        self._policy, self._check, self._scene = policy, check, Scene(connection)

    def plan(self, goal: Any, **options: Any) -> Plan:
        """`Planner.plan`, slow enough."""
        return self._slow_enough(lambda scale: Planner.plan(self, goal, **(options | {"velocity_scale": scale})))

    def plan_program(self, segments: Sequence[Segment], /, **options: Any) -> Plan:
        """`Planner.plan_program`, slow enough."""
        return self._slow_enough(
            lambda scale: Planner.plan_program(self, segments, **(options | {"velocity_scale": scale}))
        )

    def _slow_enough(self, made: Any) -> Plan:
        scale = self._policy.joint_speed
        for _ in range(_SLOWDOWNS):
            plan: Plan = made(scale)
            share = self._check.slower(plan, tuple(self._scene.attached().values()))
            if share >= 1.0:
                break
            scale = max(_SPARE * share * scale, _SLOWEST)
        return plan


class GuardedExecutor(Executor):
    """Executes plans that a policy allows, one at a time, and in a twin first if there is one."""

    def __init__(self, connection: Connection, check: PolicyCheck, twin: Twin | None = None) -> None:
        super().__init__(connection)
        self._check, self._scene, self._twin = check, Scene(connection), twin
        self._gripper = Gripper(connection)
        self._moving = threading.Lock()
        self._stops = 0

    def execute(self, what: Plan | Trajectory | ExecuteRequest | str | None = None, **options: Any) -> GoalState:
        """`Executor.execute` of a plan that the policy allows. Raises ExecutionRefused for another."""
        if not isinstance(what, Plan):
            raise InvalidRequest("an agent executes plans only", field="plan")
        self.demand(what)
        if self._twin is not None:
            stops = self._stops
            self._twin.rehearse(what, self._scene.read(), self._gripper.all())
            if self._stops != stops:
                raise Cancelled("stopped while the twin made this motion; plan again")
        return super().execute(what, **options)

    def stop(self) -> ExecutorState:
        """`Executor.stop`; a motion that the twin makes now is not made by the robot."""
        self._stops += 1
        return super().stop()

    def demand(self, plan: Plan) -> None:
        """Raise ExecutionRefused unless the policy allows a plan with what is attached now."""
        self._check.demand(plan, tuple(self._scene.attached().values()))

    @contextmanager
    def alone(self) -> Iterator[None]:
        """A block in which nothing else of this agent moves. Raises Busy while something does."""
        if not self._moving.acquire(blocking=False):
            raise Busy("a motion of this agent is under way; wait for its end, or stop it")
        try:
            yield
        finally:
            self._moving.release()
