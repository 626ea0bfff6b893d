"""Authority: checks the rest of a running goal against every scene, and tells the executor how far it may go."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

from zarm_contract.descriptor import RobotDescriptor
from zarm_contract.errors import Problem, ZarmError
from zarm_contract.messages import (
    Authority,
    CollisionDetectionState,
    GoalState,
    GoalTrajectory,
    SceneRevision,
    ServoSession,
    ServoState,
)
from zarm_runtime import clock
from zarm_runtime.bus import LatchedPublisher, Publisher
from zarm_runtime.metrics import Metrics
from zarm_runtime.worker import Worker
from zarm_servo.guarding.stopping import StoppingTime, reaction
from zarm_servo.world.check import Checker, PathValidity
from zarm_servo.world.goal_monitor import FollowedGoal, GoalMonitor
from zarm_servo.world.moving_objects import Mover
from zarm_servo.world.scene_monitor import SceneSnapshot
from zarm_servo.world.world_monitor import WorldMonitor
from zarm_trajectory.rate_bounds import RateLimits
from zarm_trajectory.trajectory import TimedTrajectory

log = logging.getLogger(__name__)

PERIOD = 0.1
"""Interval (s) at which an authority is repeated."""
_PACE = 0.008
"""Least time (s) between two checks of a goal against moving objects."""
_RECHECKED = 0.012
"""After that, the goal is checked again this much later (s) even if no pose arrives."""


class OpenSession(Protocol):
    """A session, as the guard sees it."""

    goal_id: str

    @property
    def ended(self) -> bool:
        """Whether the session has ended."""

    @property
    def revision(self) -> SceneRevision | None:
        """The scene in which its steps are checked."""

    def state(self) -> ServoSession:
        """Its current state."""


class Guard:
    """Issues authorities, in its own thread while used in `with`. `instance` is that of the service.

    `session()` is the newest session, if any. An open one checks its own steps: while no other goal runs, its goal has
    full authority. `validity(goal, until)` is called after every check of a goal that may be replanned with the path time
    up to which it may go, None for its end; and with None for both if there is no such goal. `collision_detection()` says whether collisions
    are detected.
    """

    def __init__(
        self,
        descriptor: RobotDescriptor,
        checker: Checker,
        world: WorldMonitor,
        authorities: Publisher[Authority],
        states: LatchedPublisher[ServoState],
        instance: str,
        metrics: Metrics,
        *,
        session: Callable[[], OpenSession | None],
        validity: Callable[[FollowedGoal | None, float | None], object],
        collision_detection: Callable[[], CollisionDetectionState],
    ) -> None:
        self._world, self._session, self._report_validity = world, session, validity
        self._collision_detection = collision_detection
        self._goals = GoalMonitor(descriptor.joints, world.measured)
        self._limits, self._reaction = RateLimits.of(descriptor), reaction(descriptor)
        self._checker = checker
        self._authorities = authorities
        self._states = states
        self._instance = instance
        self._metrics = metrics
        self._sequence = 0
        self._state: ServoState | None = None
        self._reported: tuple[Authority, float] | None = None
        self._done: tuple[FollowedGoal, SceneSnapshot, frozenset[str]] | None = None
        self._stopping: tuple[TimedTrajectory, StoppingTime] | None = None
        self._validity: PathValidity | ZarmError = PathValidity()
        self._took = 0.0
        self._worker = Worker("guard", self._run, PERIOD)
        world.on_change.append(self.wake)
        world.on_move.append(self._something_moved)
        world.on_state.append(self._goals.on_state)
        world.on_goal.append(self.on_goal)
        world.on_trajectory.append(self.on_trajectory)

    def __enter__(self) -> Guard:
        self._worker.wake()
        self._worker.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._worker.stop()

    # -- what is heard, from any thread --

    def _something_moved(self) -> None:
        if self._goals.newest is not None:
            self.wake()

    def wake(self) -> None:
        """Run the next check at once."""
        self._worker.wake()

    def on_trajectory(self, message: GoalTrajectory) -> None:
        """A goal begins, or its trajectory changes."""
        session = self._session()
        if session is not None and message.goal_id == session.goal_id:
            if message.number == 1:
                self.wake()
            return
        self._goals.on_trajectory(message, clock.monotonic())
        self.wake()

    def on_goal(self, goal: GoalState) -> None:
        """Take a goal's progress or result."""
        if self._goals.on_goal(goal, clock.monotonic()):
            self.wake()

    # -- the thread --

    def _run(self) -> float:
        """Check once; the longest time (s) until the next check."""
        try:
            self._check()
        finally:
            moving = self._goals.newest is not None and self._world.moving
            if moving:
                clock.sleep(_PACE)
        return _RECHECKED if moving else PERIOD

    def _check(self) -> None:
        scene = self._world.scene.snapshot(clock.monotonic())
        followed = self._goals.current(clock.monotonic())
        validity: PathValidity | ZarmError = PathValidity()
        movers = self._world.moving.of(scene)
        newest = self._session()
        session = newest if followed is None and newest is not None and not newest.ended else None
        if followed is None:
            self._done = None
        else:
            validity = self._validity_of(followed, scene, movers)
        goal_id = session.goal_id if session is not None else None if followed is None else followed.message.goal_id
        if session is not None:
            scene = replace(scene, revision=session.revision)
        problem = validity.problem if isinstance(validity, ZarmError) else None
        found = PathValidity() if isinstance(validity, ZarmError) else validity
        if problem is None:
            number = 1 if followed is None else followed.message.number
            self._authorize(goal_id, number, scene.revision, found)
        if followed is not None and followed.message.replan and problem is None:
            self._report_validity(followed, found.until)  # before the report, because replanning has no time to lose
        else:
            self._report_validity(None, None)
        self._report(goal_id, session, scene, found, problem)

    def _authorize(self, goal_id: str | None, number: int, revision: SceneRevision | None, found: PathValidity) -> None:
        """Publish how far the goal may go, unless the same was just published."""
        authority = Authority(
            servo=self._instance,
            sequence=self._sequence + 1,
            goal_id=goal_id,
            trajectory=number,
            scene_revision=revision,
            until=found.until,
            obstruction=found.obstruction,
        )
        now = clock.monotonic()
        if self._reported is not None:
            before, reported = self._reported
            if now - reported < PERIOD / 2 and before == authority.model_copy(update={"sequence": before.sequence}):
                return
        self._sequence += 1
        self._reported = authority, now
        self._authorities.put(authority)

    def _validity_of(
        self, followed: FollowedGoal, scene: SceneSnapshot, movers: tuple[Mover, ...]
    ) -> PathValidity | ZarmError:
        """How far the goal may go. Static objects are checked again only if the trajectory or the scene has changed."""
        moving = frozenset(mover.item.name for mover in movers)
        done = self._done
        if done is None or done[0].message is not followed.message or done[1] is not scene or done[2] != moving:
            self._validity = self._standing_validity_of(followed, scene, moving)
            self._done = followed, scene, moving
        if not movers or isinstance(self._validity, ZarmError):
            return self._validity
        before, reached = time.perf_counter(), self._goals.reached(followed, clock.monotonic())
        if self._stopping is None or self._stopping[0] is not followed.trajectory:
            stopping = StoppingTime(followed.trajectory, self._limits, self._reaction)
            self._stopping = followed.trajectory, stopping
        try:
            stopping_time = self._stopping[1].after(reached) + self._world.lag.seconds
            found = self._checker.validity_among(
                followed.trajectory, reached, scene, movers, clock.monotonic(), stopping_time
            )
        except ZarmError as error:
            return error
        self._note_check(time.perf_counter() - before)
        return min((self._validity, found), key=lambda each: math.inf if each.until is None else each.until)

    def _standing_validity_of(
        self, followed: FollowedGoal, scene: SceneSnapshot, moving: frozenset[str]
    ) -> PathValidity | ZarmError:
        """How far the goal may go if the objects in `moving` are ignored."""
        before = time.perf_counter()
        try:
            verified = self._world.scene.at(followed.message.scene_revision, followed.message.openings)
            return self._checker.validity(
                followed.trajectory,
                self._goals.reached(followed, clock.monotonic()),
                scene,
                verified,
                moving,
                followed.message.touches,
            )
        except ZarmError as error:
            log.error("a goal is not guarded goal_id=%s reason=%s", followed.message.goal_id, error)
            return error
        finally:
            self._note_check(time.perf_counter() - before)

    def _note_check(self, took: float) -> None:
        self._took = took
        self._metrics.time("zarm_check_seconds", "How long checks of goals took.", took)

    def _report(
        self,
        goal_id: str | None,
        session: OpenSession | None,
        scene: SceneSnapshot,
        validity: PathValidity,
        problem: Problem | None,
    ) -> None:
        state = ServoState(
            activity="idle" if goal_id is None else "guarding" if session is None else "following",
            goal_id=goal_id,
            scene_revision=scene.revision,
            scene_lost=scene.lost or self._world.planner_gone,
            until=validity.until,
            obstruction=validity.obstruction,
            problem=problem,
            check=self._took if session is None and goal_id is not None else 0.0,
            lost_objects=self._world.moving.lost(clock.monotonic()),
            pose_refused=self._world.moving.refused,
            collision_detection=self._collision_detection(),
            session=None if session is None else session.state(),
        )
        before = self._state
        if before is not None and before == state.model_copy(update={"check": before.check}):
            return
        found = validity.obstruction
        known = None if before is None or before.obstruction is None else before.obstruction.object
        if found is not None and found.object != known:
            log.warning(
                "something is in the way goal_id=%s object=%s link=%s time=%.2f until=%.2f",
                state.goal_id,
                found.object,
                found.link,
                found.time,
                validity.until or 0.0,
            )
        if state.scene_lost and scene.revision is not None and not (before and before.scene_lost):
            log.warning("the planner is gone or has lost its scene; the last known scene still counts")
        for name in set(state.lost_objects) - set(before.lost_objects if before else ()):
            log.warning("a moving object is lost, its poses no longer arrive object=%s", name)
        self._state = state
        self._states.set(state)
