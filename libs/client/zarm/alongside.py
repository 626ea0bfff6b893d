"""A motion of one group while a goal moves other joints: planned among the rest of that goal, and executed with it."""

from __future__ import annotations

from zarm.executor import Executor, OnProgress
from zarm.planner import Planner
from zarm_contract.errors import ExecutionRefused
from zarm_contract.messages import Continuation, GoalState, GoalTrajectory, PlanRequest
from zarm_trajectory.trajectory import TimedTrajectory

_LEADS = (0.4, 0.8, 1.6)
"""s from the moment of asking until the new motion takes over, one after the other: planning may take as long."""
_END = 2.0
"""s that a goal may need to come to rest at its end."""
_LATE = ("start_state_mismatch", "stale_plan")
"""What the executor says of a plan that comes too late, or for a goal that has been replanned."""


def execute_alongside(
    planner: Planner, executor: Executor, request: PlanRequest, on_progress: OnProgress | None = None
) -> GoalState:
    """See `Robot.execute_alongside`."""
    connection, keys = executor.connection, executor.connection.keys
    late: ExecutionRefused | None = None
    for lead in _LEADS:
        goal_id = executor.state().goal_id
        if goal_id is None:
            break
        followed = connection.read(keys.goal_trajectory)
        now = connection.read(keys.goal(goal_id))
        at = now.progress * now.duration + lead
        rest = _rest(followed, at) if followed.goal_id == goal_id else None
        if rest is None:  # it is as good as done, unless it is a stream
            executor.follow(goal_id, timeout=lead + _END)
            break
        beside = {"start": tuple(rest.start.tolist()), "concurrent": rest.message(followed.trajectory.joint_names)}
        plan = planner.request_plan(request.model_copy(update=beside))
        where = Continuation(goal_id=goal_id, number=followed.number, at=at)
        try:
            return executor.take_over(plan, where, on_progress)
        except ExecutionRefused as refusal:
            if refusal.problem.code not in _LATE:
                raise
            late = refusal
    else:
        if late is not None:
            raise late
    return executor.execute(planner.request_plan(request), on_progress=on_progress)


def _rest(followed: GoalTrajectory, at: float) -> TimedTrajectory | None:
    """What is left of a goal from the path time `at` (s) on; None if that is nothing."""
    motion = TimedTrajectory.of(followed.trajectory, followed.trajectory.joint_names).begun_at(followed.start)
    return None if at >= motion.duration else motion.rest(at)
