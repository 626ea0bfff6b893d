"""Replanning in motion: a goal whose way is blocked gets another trajectory to the same end, while the robot moves or from rest."""

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
    ReplaceTrajectory,
    StartState,
)
from zarm_contract.robot import RobotDescription
from zarm_runtime.bus import Latest
from zarm_runtime.metrics import Metrics
from zarm_servo.check import Checker
from zarm_servo.moving_objects import MovingObjects
from zarm_servo.scene_monitor import SceneMonitor
from zarm_servo.stopping import StoppingTime, reaction
from zarm_trajectory.rate_bounds import RateLimits
from zarm_trajectory.trajectory import TimedTrajectory

log = logging.getLogger(__name__)

SHORTEST_LEAD, LONGEST_LEAD = 0.04, 0.4
"""A new trajectory takes over this long (s) after it was asked for: the planner and two messages need so much."""
_LATER, _EARLIER = 2.0, 0.9
"""The lead is so many times as long after a plan that came too late, and after one that came in time."""
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
        self._velocity, self._limits = np.array(robot.descriptor.cspace.velocity), RateLimits.of(robot.descriptor)
        self._reaction = reaction(robot.descriptor)
        params = robot.descriptor.strategy_params
        self._delay = 0.0 if params is None else params.delay + params.point_dt
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
        self._lead = SHORTEST_LEAD
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
        """At which share of the planned speed the robot moves."""
        self._speed_scale = state.speed_scale

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
            asked = time.monotonic()
            at = self._commanded(asked) + self._lead * self._speed_scale + self._delay
            if self._blocked is None or at >= min(blocked.until, blocked.trajectory.duration):
                break
            position, velocity, acceleration = (tuple(row.tolist()) for row in blocked.trajectory.at(at))
            start = StartState(position=position, velocity=velocity, acceleration=acceleration)
            try:
                plan = self._ask(self._request(blocked, self._lead, start), self._lead)
                if self._free(plan):
                    self._put(blocked, plan, at)
                    self._lead = max(SHORTEST_LEAD, _EARLIER * self._lead)
                    self._note(blocked, "motion", time.monotonic() - asked)
                    return
            except (DeadlineExceeded, ExecutionRefused) as error:
                log.info(
                    "replanned too late goal_id=%s lead=%.3f reason=%s", blocked.message.goal_id, self._lead, error
                )
                self._lead = min(_LATER * self._lead, LONGEST_LEAD)
            except ZarmError:
                self._stops = blocked.message
                raise
        self._stops = blocked.message

    def _replan_at_rest(self, blocked: Blocked) -> None:
        asked = time.monotonic()
        try:
            plan = self._ask(self._request(blocked, REST_DEADLINE), REST_DEADLINE)
            if self._free(plan):
                self._put(blocked, plan, None)
                self._note(blocked, "rest", time.monotonic() - asked)
        except Busy:  # it has not quite come to rest
            raise
        except ZarmError:
            self._asked_at_rest = asked
            raise

    def _rests(self) -> bool:
        measured = self._measured.get(max_age=_FRESH)
        return measured is not None and max(map(abs, measured.velocity)) <= self._stopped

    def _request(self, blocked: Blocked, deadline: float, start: StartState | None = None) -> PlanRequest:
        """To the end of the trajectory, no faster than the goal was at first; from where the robot is, or from `start`."""
        _, velocity, acceleration = self._pace
        return PlanRequest(
            goal=JointGoal(kind="joints", position=tuple(blocked.trajectory.end.tolist())),
            start_state=start,
            timeout=deadline,
            optimize_s=0.0,
            velocity_scale=velocity,
            acceleration_scale=acceleration,
            publish=False,
        )

    def _free(self, plan: Plan) -> bool:
        """Whether a plan is free in the scene as it is known here by now, and of what moves: the executor follows it to its end until the
        guard has looked at it.
        """
        now = time.monotonic()
        scene, verified = self._monitor.snapshot(now), self._monitor.at(plan.scene_revision)
        trajectory, movers = TimedTrajectory.of(plan.trajectory, self._joints), self._moving.of(scene)
        moving = [mover.item.name for mover in movers]
        if self._checker.validity(trajectory, 0.0, scene, verified, moving).until is not None:
            return False
        if not movers:
            return True
        stopping = StoppingTime(trajectory, self._limits, self._reaction).after(0.0)
        return self._checker.validity_among(trajectory, 0.0, scene, movers, now, stopping).until is None

    def _put(self, blocked: Blocked, plan: Plan, at: float | None) -> None:
        message = blocked.message
        self._replace(
            ReplaceTrajectory(
                goal_id=message.goal_id,
                number=message.number,
                at=at,
                trajectory=plan.trajectory,
                scene_revision=plan.scene_revision,
            )
        )
        self._replaced = message

    def _commanded(self, now: float) -> float:
        """The path time (s) that is commanded at the moment `now`, or somewhat later. Raises Unavailable where the goal has ended."""
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
