"""From a goal to a verified trajectory: both ends, planning, verification, and another attempt if it fails."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zarm_contract.errors import DeadlineExceeded, InvalidRequest, PlanningFailed
from zarm_contract.messages import (
    Goal,
    JointGoal,
    PlanTorque,
    PoseDeviation,
    PoseGoal,
    ToolMotion,
    TooNear,
    WaypointsGoal,
)
from zarm_planner.cartesian.timing import Progress
from zarm_planner.context import PlanningContext
from zarm_planner.goals.ends import End, goal_deviation
from zarm_planner.goals.problem import PlanningProblem
from zarm_planner.planners.base import Planner
from zarm_planner.timing.improvement import GAIN
from zarm_planner.timing.rounding import rounded
from zarm_planner.timing.smoothing import least_duration
from zarm_planner.timing.torque import TooFast, TooHeavy, within_torque
from zarm_planner.verification.margins import too_near
from zarm_planner.verification.tool_path import first_contact, verify_tool_path
from zarm_planner.verification.verify import VerificationFailed, verify
from zarm_planner.verification.waypoints import passing_times
from zarm_trajectory.arrays import Array
from zarm_trajectory.trajectory import TimedTrajectory

_FASTEST_ONLY = 2
"""Attempts in which a refused trajectory is replaced by another route, before other timings of the same route are
tried.
"""


@dataclass(frozen=True)
class Verified:
    """A trajectory that may be executed; `clearance` in m, `waypoint_times` in s.

    `goal_pose` is the index of the goal's pose that it reaches, if any, `deviation` (6,) how far off it, if that is
    allowed, `too_near` the margins that it does not keep, `tool` how the tip moves along a curve, and `torque` what the joints need, if known.
    """

    trajectory: TimedTrajectory
    clearance: float
    waypoint_times: tuple[float, ...]
    goal_pose: int | None
    too_near: tuple[TooNear, ...]
    deviation: PoseDeviation | None
    tool: ToolMotion | None
    torque: PlanTorque | None

    def begun_at(self, time: float) -> Verified:
        """What is said of it as part of a motion in which it begins at `time` (s)."""
        if self.torque is None:
            return self
        return replace(self, torque=self.torque.model_copy(update={"time": self.torque.time + time}))

    def shifted(self, turns: Array) -> Verified:
        """The same motion after whole turns (dof,) in rad of continuous joints."""
        return replace(self, trajectory=self.trajectory.shifted(turns)) if turns.any() else self


def plan(planner: Planner, context: PlanningContext, start: Array, goal: Goal, motion: Array | None = None) -> Verified:
    """The trajectory that `planner` finds from `start` (dof,) to the goal. Only verified trajectories are returned.

    `motion` (2, dof) are velocity and acceleration at the start, or None at rest.

    Raises PlanningFailed (`start_in_collision`, `goal_in_collision`, `unreachable`, `no_path`), InvalidRequest for a
    goal that breaks the path constraint, and the deadline's error.
    """
    try:
        with context.timer.stage("ik"):
            problem = PlanningProblem.of(context, start, goal, motion)
        verified, seed, problem = _first(planner, context, problem)
    except (PlanningFailed, InvalidRequest, DeadlineExceeded):
        context.check_assumptions()
        raise
    if context.optimize_s > 0.0 and problem.targets:
        with context.timer.stage("optimize"):
            verified = _fastest(planner, context.with_seed(seed).for_optimization(), problem, verified)
        if context.deadline.cancelled:
            context.deadline.check()
    return verified


def _first(
    planner: Planner, context: PlanningContext, problem: PlanningProblem
) -> tuple[Verified, int, PlanningProblem]:
    """The first trajectory that passes verification, its seed, and the problem that it solves.

    Once one fails, or the first attempt finds none, all ends that are free in exact geometry count, and no others. Each
    attempt leaves tight ends by another way.
    """
    failure: VerificationFailed | None = None
    thorough = False
    try:
        attempts = planner.attempts(context, problem)
        for attempt in range(attempts):
            seeded = context.with_seed(context.seed + attempt)
            last = attempt == attempts - 1
            most = None if last or attempt >= _FASTEST_ONLY else 1
            try:
                for outcome in itertools.islice(_outcomes(planner, seeded, problem), most):
                    if isinstance(outcome, Verified):
                        return outcome, seeded.seed, problem
                    failure = outcome
            except PlanningFailed:  # proven for the ends considered so far
                if thorough or last or not (more := _more_ends(context, problem)):
                    raise
                problem, thorough = more, True
            if failure is not None:
                context.check_assumptions()
            if not thorough and (failure is not None or not last):
                problem, thorough = _with_thorough_ik(context, problem), True
            if not last:
                with context.timer.stage("ik"):
                    problem = problem.with_other_ways(context.with_seed(context.seed + attempt + 1))
    except DeadlineExceeded as late:
        if failure is None:
            raise
        raise _given_up(failure) from late
    if failure is not None:
        raise _given_up(failure)
    raise PlanningFailed(
        f"no path was found within max_attempts, {context.max_attempts}; allow more, or simplify the scene",
        code="no_path",
    )


def _outcomes(
    planner: Planner, context: PlanningContext, problem: PlanningProblem
) -> Iterator[Verified | VerificationFailed]:
    """What verification makes of each trajectory of an attempt."""
    for trajectory in planner.trajectories(context, problem):
        try:
            with context.timer.stage("verify"):
                verified = _verified(context, problem, trajectory)
        except VerificationFailed as error:
            yield error
        else:
            yield verified


def _with_thorough_ik(context: PlanningContext, problem: PlanningProblem) -> PlanningProblem:
    with context.timer.stage("ik"):
        return problem.with_thorough_ik(context)


def _more_ends(context: PlanningContext, problem: PlanningProblem) -> PlanningProblem | None:
    """The problem with thorough IK, if that finds more ends."""
    thorough = _with_thorough_ik(context, problem)
    return thorough if sum(map(len, thorough.targets)) > sum(map(len, problem.targets)) else None


def _fastest(planner: Planner, context: PlanningContext, problem: PlanningProblem, best: Verified) -> Verified:
    """The fastest of `best` and the trajectories found until the deadline of `context`."""
    least = 0.0
    if problem.lead_in is None:
        least = least_duration(problem.start.asked, problem.goals, context.limits, context.dt)
    faster_than = planner.faster(context, problem)
    while best.trajectory.duration > (1.0 + GAIN) * least:
        try:
            if (trajectory := faster_than(best.trajectory.duration)) is None:
                break
            found = _verified(context, problem, trajectory)
            if found.trajectory.duration >= best.trajectory.duration:  # slowed down, as its torques were too large
                continue
            best = found
        except VerificationFailed:
            continue
        except (DeadlineExceeded, InvalidRequest):  # InvalidRequest: a detour exceeds the message size
            break
    return best


def _verified(context: PlanningContext, problem: PlanningProblem, trajectory: TimedTrajectory) -> Verified:
    """The trajectory with its clearance. Raises VerificationFailed and the deadline's error."""
    limits, check = context.limits, context.deadline.check
    trajectory, torque = _within_torque(context, problem, trajectory)
    progress: Progress | None = None
    if problem.tool_task is not None:
        progress = Progress.of(trajectory, context.model.dof)
        trajectory = trajectory.columns(slice(context.model.dof))
    trajectory = rounded(trajectory, limits)
    ends = problem.targets[-1] if problem.targets else (End.at(trajectory.end),)
    end = ends[np.abs(problem.goals - trajectory.position[-1]).max(axis=1).argmin()] if len(ends) > 1 else ends[0]
    start, motion = problem.beginning
    try:
        clearance = verify(trajectory, start, end.asked, limits, context.exact, check, problem.constraint, motion)
    except VerificationFailed as failure:
        if progress is not None and failure.time is not None:
            raise first_contact(context.exact, trajectory, progress, check) from failure
        raise
    tool: ToolMotion | None = None
    if problem.tool_task is not None and progress is not None:
        verify_tool_path(problem.tool_task, trajectory, progress)
        tool = progress.message(problem.tool_task.curve)
    times: tuple[float, ...] = ()
    if isinstance(problem.goal, WaypointsGoal):
        waypoints = [*map(_with_poses_of_their_own, problem.goal.through, problem.targets)]
        tolerances = problem.goal.position_tolerance, problem.goal.angle_tolerance
        times = passing_times(context.model, trajectory, waypoints, *tolerances, check)
    nearer: tuple[TooNear, ...] = ()
    if clearance < max(context.world.margin, context.scene.self_margin):
        nearer = too_near(context.scene, trajectory, clearance, check)
    deviation = goal_deviation(context, problem.goal, end.pose, trajectory.position[-1])
    return Verified(trajectory, clearance, times, end.pose, nearer, deviation, tool, torque)


def _within_torque(
    context: PlanningContext, problem: PlanningProblem, trajectory: TimedTrajectory
) -> tuple[TimedTrajectory, PlanTorque | None]:
    """The trajectory, slower if a joint would need more than its largest torque, and what it needs then; None if the inertia
    of the robot is unknown. Raises VerificationFailed.
    """
    model = context.scene.exact.model
    dynamics = model.dynamics
    if dynamics is None:
        return trajectory, None
    names = (model if model.whole is None else model.whole.model).robot.descriptor.joints
    try:
        slower, use = within_torque(dynamics, trajectory, context.limits, begun=problem.beginning[1] is not None)
    except TooHeavy as error:
        raise VerificationFailed(
            f"{names[error.joint]} {error}", remedy="carry less, or choose another goal"
        ) from error
    except TooFast as error:
        raise VerificationFailed(f"{names[error.use.joint]} {error}") from error
    stretch = max(1.0, slower.duration / trajectory.duration)
    return slower, PlanTorque(joint=names[use.joint], share=use.share, time=use.time, stretch=stretch)


def _with_poses_of_their_own(waypoint: PoseGoal | JointGoal, ends: Sequence[End]) -> Array:
    """Those ends (n, dof) of a waypoint whose tips differ; without freedom, one for each of its poses."""
    if isinstance(waypoint, PoseGoal) and waypoint.has_freedom:
        return np.array([end.asked for end in ends])
    return np.array([*{end.pose: end.asked for end in ends}.values()])


def _given_up(failure: VerificationFailed) -> PlanningFailed:
    if failure.fraction is not None:
        return PlanningFailed(
            f"the curve can be followed for {100.0 * failure.fraction:.1f} % of its way: {failure}; clear the way, or move the "
            "curve",
            code="no_path",
            fraction=failure.fraction,
        )
    return PlanningFailed(
        f"every path that was found was rejected: {failure}; {failure.remedy}",
        code="no_path",
    )
