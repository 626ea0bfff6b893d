"""Replanning: a blocked goal gets another trajectory to the same end, in motion or from rest."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from zarm_contract.errors import Busy, DeadlineExceeded, ExecutionRefused, Unavailable, ZarmError
from zarm_contract.messages import (
    ExecutorState,
    GoalState,
    GoalTrajectory,
    JointGoal,
    Plan,
    PlanRequest,
    PoseGoal,
    ReplaceTrajectory,
    StartState,
)
from zarm_contract.robot import RobotDescription
from zarm_runtime import clock
from zarm_runtime.metrics import Metrics
from zarm_runtime.worker import Worker
from zarm_servo.guarding.lead import Lead
from zarm_servo.guarding.stopping import StoppingTime, reaction
from zarm_servo.world.check import LOOK_AHEAD, Checker
from zarm_servo.world.goal_monitor import FollowedGoal
from zarm_servo.world.world_monitor import WorldMonitor
from zarm_trajectory.rate_bounds import RateLimits
from zarm_trajectory.trajectory import TimedTrajectory

log = logging.getLogger(__name__)

_LEAST_TIME = 0.001
"""Least time (s) given to the planner."""
_ATTEMPTS = 4
"""Attempts to replan a blocked trajectory in motion before the robot stops."""
REST_DEADLINE = 1.0
"""Time limit (s) for a plan from rest."""
REST_PERIOD = 0.5
"""Interval (s) of the attempts to plan from rest."""
_FRESH = 0.2
"""Greatest age (s) of measured joints."""
_PACE = 1.05
"""A new trajectory may use this many times the velocity and acceleration of the old one, because it may start between
samples.
"""
_LEAST_PACE = 0.05
"""Least share of the limits to request."""


@dataclass(frozen=True)
class Blocked:
    """A blocked goal and the trajectory it follows, which is free up to the path time `until` (s)."""

    message: GoalTrajectory
    trajectory: TimedTrajectory
    until: float


class Replanner:
    """Replans blocked goals, in its own thread while used in `with`.

    `ask` plans a request within the given time (s), and `replace` replaces the trajectory; both raise the ZarmError of
    the answer.
    """

    def __init__(
        self,
        robot: RobotDescription,
        checker: Checker,
        world: WorldMonitor,
        ask: Callable[[PlanRequest, float], Plan],
        replace: Callable[[ReplaceTrajectory], object],
        metrics: Metrics,
    ) -> None:
        self._robot, self._joints = robot, robot.descriptor.joints
        self._timing = robot.descriptor.command_timing
        self._velocity, self._limits = np.array(robot.descriptor.cspace.velocity), RateLimits.of(robot.descriptor)
        self._reaction = reaction(robot.descriptor)
        self._ahead = 0.0
        self._checker = checker
        self._world = world
        self._stopped = robot.descriptor.execution.stopped_velocity
        self._ask, self._replace = ask, replace
        self._metrics = metrics
        self._blocked: Blocked | None = None
        self._goal: tuple[GoalState, float] | None = None
        self._speed_scale = 1.0
        self._pace: tuple[str, float, float] = ("", 1.0, 1.0)
        self._lead = Lead()
        self._stops: GoalTrajectory | None = None  # cannot be replanned in motion
        self._replaced: GoalTrajectory | None = None  # already replaced at the executor
        self._asked_at_rest = -np.inf
        self._worker = Worker("replanning", self._run)
        world.on_state.append(self._on_state)
        world.on_goal.append(self.on_goal)

    def __enter__(self) -> Replanner:
        self._worker.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._worker.stop()

    # -- what is heard, from any thread --

    def _on_state(self, state: ExecutorState) -> None:
        """Take the robot's share of the planned speed, and how far (s) the command is ahead of the reported progress."""
        self._speed_scale, timing = state.speed_scale, self._timing
        self._ahead = 0.0 if timing is None or state.strategy == "emulator" else timing.delay + timing.point_dt

    def on_goal(self, goal: GoalState) -> None:
        """Take a goal's progress."""
        self._goal = None if goal.done else (goal, clock.monotonic())

    def on_validity(self, followed: FollowedGoal | None, until: float | None) -> None:
        """A goal that may be replanned may go up to the path time `until` (s), or to its end if None. Without a goal,
        there is nothing to replan.
        """
        if followed is None:
            self._blocked = None
            return
        message, trajectory = followed.message, followed.trajectory
        if message.goal_id != self._pace[0]:
            self._pace = (message.goal_id, *self._used(trajectory))
        if until is None:
            self._stops = None
        self._blocked = None if until is None else Blocked(message, trajectory, until)
        self._worker.wake()

    # -- the thread --

    def _run(self) -> None:
        blocked, latest = self._blocked, self._goal
        if blocked is None or latest is None or latest[0].goal_id != blocked.message.goal_id:
            return
        goal = latest[0]
        if goal.status != "running" or blocked.message is self._replaced:
            return
        try:  # if this fails, the goal stays held, as without replanning
            in_motion = blocked.message is not self._stops and blocked.message.path_constraint is None
            if in_motion:
                self._replan_in_motion(blocked)
            elif goal.hold is not None and self._rests() and clock.monotonic() - self._asked_at_rest > REST_PERIOD:
                self._replan_at_rest(blocked)
        except ZarmError as error:
            log.info("not replanned goal_id=%s reason=%s", blocked.message.goal_id, error)

    def _replan_in_motion(self, blocked: Blocked) -> None:
        """Plan from a state ahead. Raises the ZarmError that prevents a plan in motion."""
        for _ in range(_ATTEMPTS):
            asked, lead = clock.monotonic(), self._lead.seconds
            at = self._commanded(asked) + (lead + self._ahead) * self._speed_scale
            if self._blocked is None or at >= min(blocked.until, blocked.trajectory.duration):
                break
            position, velocity, acceleration = (tuple(row.tolist()) for row in blocked.trajectory.at(at))
            start = StartState(position=position, velocity=velocity, acceleration=acceleration)
            try:
                plan = self._plan(blocked, asked + lead, start)
                if self._follow(blocked, plan, at):
                    took = clock.monotonic() - asked
                    self._lead.in_time(took)
                    self._note(blocked, "motion", took)
                    return
            except (DeadlineExceeded, ExecutionRefused) as error:
                log.info("replanned too late goal_id=%s lead=%.3f reason=%s", blocked.message.goal_id, lead, error)
                self._lead.too_late()
            except ZarmError as error:
                if error.problem.code != "no_path":
                    self._stops = blocked.message
                    raise
        self._stops = blocked.message

    def _replan_at_rest(self, blocked: Blocked) -> None:
        asked = clock.monotonic()
        try:
            plan = self._plan(blocked, asked + REST_DEADLINE)
            if self._follow(blocked, plan, None):
                self._note(blocked, "rest", clock.monotonic() - asked)
        except Busy:  # not quite at rest yet
            raise
        except ZarmError:
            self._asked_at_rest = asked
            raise

    def _rests(self) -> bool:
        measured = self._world.measured.get(max_age=_FRESH)
        return measured is not None and max(map(abs, measured.velocity)) <= self._stopped

    def _plan(self, blocked: Blocked, deadline: float, start: StartState | None = None) -> Plan:
        """A plan to the end of the trajectory, by the deadline (s, monotonic), from the current state or from `start`.

        If those joints are in collision and the goal is a pose, a plan to any joints that bring the tip there. Of a robot with groups, the
        smallest one that has all joints that move.
        """
        moving = np.ptp(blocked.trajectory.position, axis=0) > 0.0
        group = self._robot.group_with([joint for joint, moves in zip(self._joints, moving, strict=True) if moves])
        own = self._joints if group is None else self._robot.group_joints(group)
        end = dict(zip(self._joints, blocked.trajectory.end.tolist(), strict=True))
        joints, tip = JointGoal(kind="joints", position=tuple(end[joint] for joint in own)), blocked.message.tip
        try:
            return self._ask_for(blocked, joints, group, deadline, start)
        except ZarmError as error:
            if tip is None or error.problem.code != "goal_in_collision":
                raise
        pose = PoseGoal(kind="pose", position=tip.position, orientation=tip.orientation)
        return self._ask_for(blocked, pose, group, deadline, start)

    def _ask_for(
        self,
        blocked: Blocked,
        goal: JointGoal | PoseGoal,
        group: str | None,
        deadline: float,
        start: StartState | None,
    ) -> Plan:
        """A plan no faster than the goal was at first. Raises DeadlineExceeded at `deadline` (s, monotonic)."""
        _, velocity, acceleration = self._pace
        left = max(clock.real_seconds(deadline - clock.monotonic()), _LEAST_TIME)
        return self._ask(
            PlanRequest(
                goal=goal,
                group=group,
                start_state=start,
                path_constraint=blocked.message.path_constraint,
                timeout=left,
                optimize_s=0.0,
                velocity_scale=velocity,
                acceleration_scale=acceleration,
                publish=False,
            ),
            left,
        )

    def _follow(self, blocked: Blocked, plan: Plan, at: float | None) -> bool:
        """Make the executor follow a plan if it is still free in the latest known scene and of moving objects; returns
        whether it does.
        """
        now = clock.monotonic()
        scene, verified = self._world.scene.snapshot(now), self._world.scene.at(plan.scene_revision, plan.openings)
        trajectory, movers = TimedTrajectory.of(plan.trajectory, self._joints), self._world.moving.of(scene)
        moving = [mover.item.name for mover in movers]
        if self._checker.validity(trajectory, 0.0, scene, verified, moving).until is not None:
            return False
        until = None
        if movers:
            stopping = StoppingTime(trajectory, self._limits, self._reaction).after(0.0) + self._world.lag.seconds
            if self._checker.validity_among(trajectory, 0.0, scene, movers, now, stopping).until is not None:
                return False
            until = LOOK_AHEAD
        message = blocked.message
        self._replace(
            ReplaceTrajectory(
                goal_id=message.goal_id,
                number=message.number,
                at=at,
                trajectory=plan.trajectory,
                scene_revision=plan.scene_revision,
                until=until,
                openings=plan.openings,
            )
        )
        self._replaced = message
        return True

    def _commanded(self, now: float) -> float:
        """The path time (s) commanded at `now`, or slightly more. Raises Unavailable if the goal has ended."""
        latest = self._goal
        if latest is None:
            raise Unavailable("the goal has ended")
        goal, reported = latest
        return goal.progress * goal.duration + (now - reported) * self._speed_scale

    def _used(self, trajectory: TimedTrajectory) -> tuple[float, float]:
        """The shares of the velocity and acceleration limits allowed for the trajectory that replaces this one."""
        velocity = float((np.abs(trajectory.velocity) / self._velocity).max())
        acceleration = float((np.abs(trajectory.acceleration) / self._limits.acceleration).max())
        return min(max(_PACE * velocity, _LEAST_PACE), 1.0), min(max(_PACE * acceleration, _LEAST_PACE), 1.0)

    def _note(self, blocked: Blocked, kind: str, took: float) -> None:
        log.info("replanned goal_id=%s from=%s seconds=%.3f", blocked.message.goal_id, kind, took)
        self._metrics.time("zarm_replanning_seconds", "How long it took to replan a blocked goal.", took, start=kind)
