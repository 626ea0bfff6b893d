"""Replanning: a blocked goal gets another trajectory to the same end, in motion or from rest."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from zarm_contract.errors import Busy, DeadlineExceeded, ExecutionRefused, Unavailable, ZarmError
from zarm_contract.messages import (
    ExecutorState,
    GoalState,
    GoalTrajectory,
    JointGoal,
    JointState,
    Plan,
    PlanRequest,
    PoseGoal,
    ReplaceTrajectory,
    StartState,
)
from zarm_contract.robot import RobotDescription
from zarm_runtime.bus import Latest
from zarm_runtime.metrics import Metrics
from zarm_servo.check import AHEAD, Checker
from zarm_servo.lead import Lead
from zarm_servo.moving_objects import MovingObjects
from zarm_servo.scene_monitor import SceneMonitor
from zarm_servo.stopping import StoppingTime, reaction
from zarm_trajectory.rate_bounds import RateLimits
from zarm_trajectory.trajectory import TimedTrajectory

log = logging.getLogger(__name__)

_LEAST_TIME = 0.001
"""The planner is given so long (s) at least."""
_ATTEMPTS = 4
"""So often a blocked trajectory is planned anew in motion; then the robot stops first."""
REST_DEADLINE = 1.0
"""How long (s) the planner may take for a robot that rests."""
REST_PERIOD = 0.5
"""How often (s) it is asked for one."""
_FRESH = 0.2
"""Measured joints count for so long (s)."""
_PACE = 1.05
"""A new trajectory may use so many times the velocity and acceleration of the one that it replaces: a start between samples."""
_LEAST_PACE = 0.05
"""Least share of the limits that is asked for."""


@dataclass(frozen=True)
class Blocked:
    """A goal that is blocked: what it follows, free up to the path time `until` (s)."""

    message: GoalTrajectory
    trajectory: TimedTrajectory
    until: float


class Replanner:
    """Replans blocked goals, in a thread of its own while it is used in `with`.

    `ask` has a request planned within so many seconds, and `replace` the trajectory replaced; both raise the ZarmError that is the answer.
    """

    def __init__(
        self,
        robot: RobotDescription,
        checker: Checker,
        monitor: SceneMonitor,
        moving: MovingObjects,
        measured: Latest[JointState],
        ask: Callable[[PlanRequest, float], Plan],
        replace: Callable[[ReplaceTrajectory], object],
        metrics: Metrics,
    ) -> None:
        self._joints = robot.descriptor.joints
        self._strategy_params = robot.descriptor.strategy_params
        self._velocity, self._limits = np.array(robot.descriptor.cspace.velocity), RateLimits.of(robot.descriptor)
        self._reaction = reaction(robot.descriptor)
        self._ahead = 0.0
        self._checker = checker
        self._monitor, self._moving = monitor, moving
        self._measured = measured
        self._stopped = robot.descriptor.execution.stopped_velocity
        self._ask, self._replace = ask, replace
        self._metrics = metrics
        self._blocked: Blocked | None = None
        self._goal: tuple[GoalState, float] | None = None
        self._speed_scale = 1.0
        self._pace: tuple[str, float, float] = ("", 1.0, 1.0)
        self._lead = Lead()
        self._stops: GoalTrajectory | None = None  # of which there is no plan in motion
        self._replaced: GoalTrajectory | None = None  # which the executor follows no longer
        self._asked_at_rest = -np.inf
        self._news = threading.Event()
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="replanning", daemon=True)

    def __enter__(self) -> Replanner:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closing = True
        self._news.set()
        self._thread.join()

    # -- what is heard, from any thread --

    def hear_state(self, _key: str, state: ExecutorState) -> None:
        """At which share of the planned speed the robot moves, and how far (s) ahead of what it tells it is commanded."""
        self._speed_scale, params = state.speed_scale, self._strategy_params
        self._ahead = 0.0 if params is None or state.strategy == "emulator" else params.delay + params.point_dt

    def hear_goal(self, _key: str, goal: GoalState) -> None:
        """How far a goal is."""
        self._goal = None if goal.done else (goal, time.monotonic())

    def see(self, message: GoalTrajectory, trajectory: TimedTrajectory, until: float | None) -> None:
        """A goal that is to be replanned may go up to the path time `until` (s), None: to its end."""
        if message.goal_id != self._pace[0]:
            self._pace = (message.goal_id, *self._used(trajectory))
        if until is None:
            self._stops = None
        self._blocked = None if until is None else Blocked(message, trajectory, until)
        self._news.set()

    def forget(self) -> None:
        """There is no goal to be replanned."""
        self._blocked = None

    # -- the thread --

    def _run(self) -> None:
        while not self._closing:
            self._news.wait()
            self._news.clear()
            blocked, heard = self._blocked, self._goal
            if blocked is None or heard is None or heard[0].goal_id != blocked.message.goal_id:
                continue
            goal = heard[0]
            if goal.status != "running" or blocked.message is self._replaced:
                continue
            try:
                if blocked.message is not self._stops:
                    self._replan_in_motion(blocked)
                elif goal.hold is not None and self._rests() and time.monotonic() - self._asked_at_rest > REST_PERIOD:
                    self._replan_at_rest(blocked)
            except ZarmError as error:
                log.info("not replanned goal_id=%s reason=%s", blocked.message.goal_id, error)
            except Exception:  # the goal is held as without replanning
                log.exception("replanning failed")

    def _replan_in_motion(self, blocked: Blocked) -> None:
        """Plan from a state ahead. Raises the ZarmError for which there is no plan in motion."""
        for _ in range(_ATTEMPTS):
            asked, lead = time.monotonic(), self._lead.seconds
            at = self._commanded(asked) + (lead + self._ahead) * self._speed_scale
            if self._blocked is None or at >= min(blocked.until, blocked.trajectory.duration):
                break
            position, velocity, acceleration = (tuple(row.tolist()) for row in blocked.trajectory.at(at))
            start = StartState(position=position, velocity=velocity, acceleration=acceleration)
            try:
                plan = self._plan(blocked, asked + lead, start)
                if self._follow(blocked, plan, at):
                    took = time.monotonic() - asked
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
        asked = time.monotonic()
        try:
            plan = self._plan(blocked, asked + REST_DEADLINE)
            if self._follow(blocked, plan, None):
                self._note(blocked, "rest", time.monotonic() - asked)
        except Busy:  # it has not quite come to rest
            raise
        except ZarmError:
            self._asked_at_rest = asked
            raise

    def _rests(self) -> bool:
        measured = self._measured.get(max_age=_FRESH)
        return measured is not None and max(map(abs, measured.velocity)) <= self._stopped

    def _plan(self, blocked: Blocked, deadline: float, start: StartState | None = None) -> Plan:
        """To the end of the trajectory before the moment `deadline` (s, monotonic), from where the robot is, or from `start`.

        Where something stands at those joints and the goal is a pose, to any joints that bring the tip there.
        """
        joints, tip = JointGoal(kind="joints", position=tuple(blocked.trajectory.end.tolist())), blocked.message.tip
        try:
            return self._ask_for(joints, deadline, start)
        except ZarmError as error:
            if tip is None or error.problem.code != "goal_in_collision":
                raise
        return self._ask_for(PoseGoal(kind="pose", position=tip.position, orientation=tip.orientation), deadline, start)

    def _ask_for(self, goal: JointGoal | PoseGoal, deadline: float, start: StartState | None) -> Plan:
        """A plan that is no faster than the goal was at first. Raises DeadlineExceeded at the moment `deadline` (s, monotonic)."""
        _, velocity, acceleration = self._pace
        left = max(deadline - time.monotonic(), _LEAST_TIME)
        return self._ask(
            PlanRequest(
                goal=goal,
                start_state=start,
                timeout=left,
                optimize_s=0.0,
                velocity_scale=velocity,
                acceleration_scale=acceleration,
                publish=False,
            ),
            left,
        )

    def _follow(self, blocked: Blocked, plan: Plan, at: float | None) -> bool:
        """Have the executor follow a plan that is free in the scene as it is known here by now, and of what moves; whether it is."""
        now = time.monotonic()
        scene, verified = self._monitor.snapshot(now), self._monitor.at(plan.scene_revision)
        trajectory, movers = TimedTrajectory.of(plan.trajectory, self._joints), self._moving.of(scene)
        moving = [mover.item.name for mover in movers]
        if self._checker.validity(trajectory, 0.0, scene, verified, moving).until is not None:
            return False
        until = None
        if movers:
            stopping = StoppingTime(trajectory, self._limits, self._reaction).after(0.0)
            if self._checker.validity_among(trajectory, 0.0, scene, movers, now, stopping).until is not None:
                return False
            until = AHEAD
        message = blocked.message
        self._replace(
            ReplaceTrajectory(
                goal_id=message.goal_id,
                number=message.number,
                at=at,
                trajectory=plan.trajectory,
                scene_revision=plan.scene_revision,
                until=until,
            )
        )
        self._replaced = message
        return True

    def _commanded(self, now: float) -> float:
        """The path time (s) that is commanded at the moment `now`, or somewhat later. Raises Unavailable if the goal has ended."""
        heard = self._goal
        if heard is None:
            raise Unavailable("the goal has ended")
        goal, told = heard
        return goal.progress * goal.duration + (now - told) * self._speed_scale

    def _used(self, trajectory: TimedTrajectory) -> tuple[float, float]:
        """The shares of the velocity and acceleration limits that a trajectory may take that replaces this one."""
        velocity = float((np.abs(trajectory.velocity) / self._velocity).max())
        acceleration = float((np.abs(trajectory.acceleration) / self._limits.acceleration).max())
        return min(max(_PACE * velocity, _LEAST_PACE), 1.0), min(max(_PACE * acceleration, _LEAST_PACE), 1.0)

    def _note(self, blocked: Blocked, kind: str, took: float) -> None:
        log.info("replanned goal_id=%s from=%s seconds=%.3f", blocked.message.goal_id, kind, took)
        self._metrics.time("zarm_replanning_seconds", "How long it took to replan a blocked goal.", took, start=kind)
