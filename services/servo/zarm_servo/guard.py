"""Authority: while a goal runs, what is left of it is checked against every scene, and the executor is told how far it may go."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from zarm_contract.errors import Problem, ZarmError
from zarm_contract.messages import Authority, ExecutorState, GoalState, GoalTrajectory, JointState, ServoState
from zarm_runtime.bus import Latched, Latest, Publisher
from zarm_runtime.metrics import Metrics
from zarm_servo.check import Checker, Way
from zarm_servo.world import Mirror, Seen
from zarm_trajectory.trajectory import TimedTrajectory

log = logging.getLogger(__name__)

PERIOD = 0.1
"""How often (s) an authority is repeated."""
_STARTED = 2.0
"""A goal whose trajectory was told so long (s) ago runs, or was refused after all."""
_BEHIND = 0.3
"""How far (s of the path) the robot may be behind what was commanded last."""
_AHEAD = 0.05
"""How much (s) older than its arrival what a goal tells of itself may be."""


@dataclass(frozen=True)
class Followed:
    """The trajectory of a goal, which was there first at the moment `since` (s, monotonic); at the moment `told` the executor
    commanded the path time `commanded` (s)."""

    message: GoalTrajectory
    trajectory: TimedTrajectory
    since: float
    commanded: float
    told: float


class Guard:
    """Gives authority, in a thread of its own while it is used in `with`. `instance` is that of the service."""

    def __init__(
        self,
        joints: tuple[str, ...],
        checker: Checker,
        measured: Latest[JointState],
        authorities: Publisher[Authority],
        states: Latched[ServoState],
        instance: str,
        metrics: Metrics,
    ) -> None:
        self.mirror = Mirror(self.wake)
        self._joints = joints
        self._checker = checker
        self._measured = measured
        self._authorities = authorities
        self._states = states
        self._instance = instance
        self._metrics = metrics
        self._followed: Followed | None = None
        self._ended: deque[str] = deque(maxlen=32)
        self._running: str | None = None
        self._sequence = 0
        self._planner_gone = False
        self._state: ServoState | None = None
        self._done: tuple[Followed | None, Seen] | None = None
        self._way: Way | ZarmError = Way()
        self._took = 0.0
        self._news = threading.Event()
        self._closing = False
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._run, name="guard", daemon=True)

    def __enter__(self) -> Guard:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closing = True
        self.wake()
        self._thread.join()

    # -- what is heard, from any thread --

    def wake(self) -> None:
        """Look again at once."""
        self._news.set()

    def hear_trajectory(self, _key: str, message: GoalTrajectory) -> None:
        """A goal begins, or its trajectory changes."""
        try:
            trajectory = TimedTrajectory.of(message.trajectory, self._joints).begun_at(message.start)
        except ZarmError as error:
            log.warning("a goal cannot be guarded goal_id=%s reason=%s", message.goal_id, error)
            return
        with self._lock:
            before = self._followed
            if message.goal_id in self._ended:
                return
            if before is not None and before.message.goal_id == message.goal_id:
                self._followed = replace(before, message=message, trajectory=trajectory)
            else:
                now = time.monotonic()
                self._followed = Followed(message, trajectory, since=now, commanded=message.start, told=now)
        self.wake()

    def hear_goal(self, _key: str, goal: GoalState) -> None:
        """How far a goal is, or how it ended."""
        with self._lock:
            if goal.done:
                self._ended.append(goal.goal_id)
            followed = self._followed
            if followed is None or followed.message.goal_id != goal.goal_id:
                return
            if goal.done:
                self._followed = None
                self.wake()
            else:
                self._followed = replace(followed, commanded=goal.progress * goal.duration, told=time.monotonic())

    def hear_state(self, _key: str, state: ExecutorState) -> None:
        """Which goal runs."""
        self._running = state.goal_id

    def hear_planner(self, *, gone: bool) -> None:
        """Whether there is a planner."""
        self._planner_gone = gone

    # -- the thread --

    def _run(self) -> None:
        while not self._closing:
            try:
                self._look()
            except Exception:  # a guard that ends would leave every goal without one, and say nothing
                log.exception("the guard failed; it goes on")
            self._news.wait(PERIOD)
            self._news.clear()

    def _look(self) -> None:
        seen = self.mirror.seen(time.monotonic())
        with self._lock:
            followed = self._followed
            if followed is not None and self._running != followed.message.goal_id and _old(followed):
                followed = self._followed = None
        way: Way | ZarmError = Way()
        if followed is None:
            self._done = None
        else:
            way = self._way_of(followed, seen)
        problem = way.problem if isinstance(way, ZarmError) else None
        found = Way() if isinstance(way, ZarmError) else way
        if problem is None:
            self._sequence += 1
            self._authorities.put(
                Authority(
                    servo=self._instance,
                    sequence=self._sequence,
                    goal_id=None if followed is None else followed.message.goal_id,
                    trajectory=1 if followed is None else followed.message.number,
                    scene_revision=seen.revision,
                    until=found.until,
                    obstruction=found.obstruction,
                )
            )
        self._tell(followed, seen, found, problem)

    def _way_of(self, followed: Followed, seen: Seen) -> Way | ZarmError:
        """How far it may go; looked at again where the trajectory or the scene is another than the last time."""
        done = self._done
        if done is not None and done[0] is not None and done[0].message is followed.message and done[1] is seen:
            return self._way
        before = time.perf_counter()
        try:
            verified = self.mirror.at(followed.message.scene_revision)
            self._way = self._checker.way(followed.trajectory, self._reached(followed), seen, verified)
        except ZarmError as error:
            self._way = error
            log.error("a goal is not guarded goal_id=%s reason=%s", followed.message.goal_id, error)
        self._took = time.perf_counter() - before
        self._metrics.time("zarm_check_seconds", "How long checks of goals took.", self._took)
        self._done = followed, seen
        return self._way

    def _reached(self, followed: Followed) -> float:
        """The path time (s) at which the robot is, or somewhat earlier."""
        trajectory, measured = followed.trajectory, self._measured.get(max_age=_BEHIND)
        first = max(followed.commanded - _BEHIND, float(trajectory.time[0]))
        last = min(followed.commanded + time.monotonic() - followed.told + _AHEAD, trajectory.duration)
        if measured is None or set(measured.joint_names) != set(self._joints):
            return first
        order = [measured.joint_names.index(name) for name in self._joints]
        return trajectory.nearest(np.array(measured.position)[order], first, max(first, last))

    def _tell(self, followed: Followed | None, seen: Seen, way: Way, problem: Problem | None) -> None:
        state = ServoState(
            activity="idle" if followed is None else "guarding",
            goal_id=None if followed is None else followed.message.goal_id,
            scene_revision=seen.revision,
            scene_lost=seen.lost or self._planner_gone,
            until=way.until,
            obstruction=way.obstruction,
            problem=problem,
            check=0.0 if followed is None else self._took,
        )
        before = self._state
        if state == before:
            return
        found = way.obstruction
        if found is not None and (before is None or before.obstruction != found):
            log.warning(
                "something is in the way goal_id=%s object=%s link=%s time=%.2f until=%.2f",
                state.goal_id,
                found.object,
                found.link,
                found.time,
                way.until or 0.0,
            )
        if state.scene_lost and not (before and before.scene_lost):
            log.warning("the planner is gone or has lost its scene; what is known of it still counts")
        self._state = state
        self._states.set(state)


def _old(followed: Followed) -> bool:
    return time.monotonic() - followed.since > _STARTED
