"""A session: every 4 ms one step towards a live target, streamed to the executor."""

from __future__ import annotations

import logging
import threading
from collections import OrderedDict, deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from zarm_contract.errors import Busy, Unavailable, from_problem
from zarm_contract.messages import (
    ChunkAccepted,
    ExecutorState,
    GoalState,
    GoalTrajectory,
    SceneRevision,
    ServoChunk,
    ServoSession,
    ServoStart,
    StreamChunk,
)
from zarm_contract.robot import RobotDescription
from zarm_geometry.robot_model import RobotModel
from zarm_runtime import clock
from zarm_runtime.bus import Publisher
from zarm_runtime.metrics import Metrics
from zarm_runtime.realtime import PROCESS_PRIORITY, ask_for_realtime
from zarm_servo.kernels.step import PERIOD
from zarm_servo.tracking.chunk_tracking import ChunkTracking
from zarm_servo.tracking.clock import StreamClock
from zarm_servo.tracking.controller import STALE, Controller, Limitation, Step, Surroundings
from zarm_servo.tracking.global_plan import PlanFor, find_global_plan
from zarm_servo.tracking.grip_follower import GripFollower, MoveGripper
from zarm_servo.tracking.inbox import Inbox, ahead
from zarm_servo.tracking.local_goal import LocalGoal
from zarm_servo.tracking.session_scene import SessionScene
from zarm_servo.tracking.streamed_trajectory import StreamedTrajectory
from zarm_servo.tracking.targets import JointTarget, PoseTarget, Target
from zarm_servo.world.check import SceneCheck
from zarm_servo.world.world_monitor import WorldMonitor
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

log = logging.getLogger(__name__)

CHUNK = 5
"""Steps in a chunk: 50 chunks a second leave the executor time for other work."""
LEAD = 0.06
"""Steps are computed this far (s) ahead of the executor's command: a chunk needs time to arrive, and waits for a tick
there.
"""
DEADLINE = 0.3
"""The executor brakes if no chunk has come for this long (s)."""
_PATH_TOLERANCE = 1e-4
"""If the executor's trajectory differs by more than this (rad) from the steps, a chunk came too late and it is
blending.
"""
_CHUNK_TIMEOUT = 0.1
"""After this time (s) the executor has taken every chunk, or dropped it."""
_CHUNKS_KEPT = 50
"""Number of chunks remembered."""
_LONGEST_CHUNK_PERIOD = 0.08
"""Longest time (s) between two chunks, however slowly the robot moves."""
_CATCH_UP_PERIOD = PERIOD / 2
"""Time (s) from one cycle to the next while steps are missing, at the start or after a late cycle."""
_LATE_CYCLE = 0.002
"""A cycle that begins later than this (s) counts as late."""
_ACCELERATION_TIME = 0.02
"""Time (s) that an acceleration takes to reach its limit: keeps the overshoot of a chunk's quintics between samples
small.
"""
_ACCELERATION_SHARE = 0.98
"""Share of the acceleration limit that is used, for the same reason."""
_START_TIMEOUT = 3.0
"""The executor accepts or refuses a stream within this time (s)."""
_REST_TIMEOUT = 5.0
"""Longest time (s) that a robot takes to come to rest."""
_IDLE_TIMEOUT = 10.0
"""A session without a fresh target for this long (s) is ended."""
_EXECUTOR_TIMEOUT = 2.0
"""An executor that has not reported on the stream for this long (s) is gone."""
_REPORT_PERIOD = 0.05
"""Least time (s) between two reports of what limits a session."""
_MOVING_SPEED = 1e-3
"""Joint speed (rad/s) above which a robot counts as moving."""
_SEARCHES = 2
"""Most global plans searched for at a time: one for the target, and one for a target that has jumped since."""
_PRIORITY = 15
"""Real-time priority of the cycles, below that of the executor's."""


@dataclass(frozen=True)
class Snapshot:
    """The result of the last cycle."""

    limitation: Limitation = field(default_factory=lambda: Limitation("target_stale"))
    target: Target | None = None
    age: float | None = None
    moving: bool = False


@dataclass(frozen=True)
class SessionConfig:
    """What all sessions of a robot share.

    The open session owns `check`. It calls `changed()` when what limits it changes, and asks the planner through `plan`
    when the controller is stuck, and moves grippers by `move_gripper`.
    """

    robot: RobotDescription
    check: SceneCheck
    world: WorldMonitor
    chunks: Publisher[StreamChunk]
    plan: PlanFor
    move_gripper: MoveGripper
    metrics: Metrics
    changed: Callable[[], object]


class Session:
    """Leads the goal `goal_id`, from rest at `position` (J,); the executor expects the robot `delay` s behind its command."""

    def __init__(
        self,
        goal_id: str,
        request: ServoStart,
        config: SessionConfig,
        position: Array,
        delay: float,
    ) -> None:
        robot, check, world = config.robot, config.check, config.world
        self.goal_id, self._margin = goal_id, request.margin
        self.inbox = Inbox(robot)
        self._joints = robot.descriptor.joints
        # No tool is changed while a goal runs.
        self._model: RobotModel = check.model.with_tools(world.scene.snapshot(clock.monotonic()).attached)
        self._measured, self._lag = world.measured, world.lag
        self._chunks, self._changed, self._delay = config.chunks, config.changed, delay
        self._scene = SessionScene(check, world.scene, world.moving, clock.monotonic(), self._give_up)
        limits = soft(Limits.of(robot, request.velocity_scale, request.acceleration_scale))
        self._controller = Controller(self._model, check.motions, limits, position, margin=request.margin)
        self._metrics = config.metrics
        self._pool = ThreadPoolExecutor(
            _SEARCHES,
            thread_name_prefix="global-plan",
            initializer=ask_for_realtime,  # else a thread that a cycle starts has the priority of the cycles
            initargs=(PROCESS_PRIORITY,),
        )
        grip = GripFollower(
            config.move_gripper, self._pool, lambda problem: self.inbox.refuse(problem, clock.monotonic())
        )
        self._chunk_tracking = ChunkTracking(self._model, limits, self._controller, grip, self._measured.get)
        find = partial(find_global_plan, config.plan, self._joints, request.margin)
        self._local_goal = LocalGoal(self._model, find, partial(self._scene.is_free, margin=request.margin), self._pool)
        self._streamed = StreamedTrajectory(0.0, self._controller.state, self._controller.braking)
        self._ends: OrderedDict[int, tuple[float, Array]] = OrderedDict()
        self._followed: tuple[int, TimedTrajectory] | None = None
        self._off_path = False
        self._clock = StreamClock(delay)
        self._sequence, self._sent_at = 0, 0.0
        self._used = clock.monotonic()
        self._snapshot = Snapshot()
        self._goal: GoalState | None = None
        self._received_at = self._reported_at = self._used
        self._reported = threading.Event()
        self._done = threading.Event()
        self._closing = self._held = False
        self._cycles = self._late = 0
        self._took: deque[float] = deque(maxlen=100)
        self._thread = threading.Thread(target=self._run, name="session", daemon=True)

    # -- from any thread --

    @property
    def revision(self) -> SceneRevision | None:
        """The scene in which the steps are checked."""
        return self._scene.revision

    @property
    def ended(self) -> bool:
        """Whether the session has ended."""
        return self._done.is_set()

    def open(self) -> None:
        """Begin. Raises the executor's refusal, and Unavailable if the executor does not answer."""
        try:
            standing = TimedTrajectory.standing(self._controller.state[0], 1.0)
            self._put(0.0, standing, deadline=1.0)
            if not self._reported.wait(_START_TIMEOUT):
                raise Unavailable(
                    f"the executor did not take the stream within {_START_TIMEOUT:g} s; `zarm status` shows whether it runs"
                )
            if self._goal is not None and self._goal.problem is not None:
                raise from_problem(self._goal.problem)
        except BaseException:
            self._pool.shutdown(wait=False, cancel_futures=True)
            self._done.set()
            raise
        self._scene.open()
        self._thread.start()

    def close(self) -> None:
        """Bring the robot to rest and end; returns when done. Raises Busy if it takes too long."""
        self._give_up()
        if not self._done.wait(_REST_TIMEOUT):
            raise Busy(f"the session {self.goal_id} has not ended yet; see where the robot is, then try again")

    def _give_up(self) -> None:
        self._closing = True

    def on_goal(self, goal: GoalState) -> None:
        """Take a state of the stream from the executor."""
        self._received_at = clock.monotonic()
        self._clock.receive(goal, self._received_at)
        self._goal = goal
        self._held = goal.status == "paused"
        if goal.status != "accepted":
            self._reported.set()

    def on_trajectory(self, message: GoalTrajectory) -> None:
        """Take the trajectory that the executor follows after each chunk, and compare it with what was checked."""
        trajectory = TimedTrajectory.of(message.trajectory, self._joints).begun_at(message.start)
        time_there, state = self._ends.get(message.number, (-1.0, np.empty(0)))
        if time_there >= trajectory.time[0]:
            self._off_path = float(np.abs(trajectory.at(time_there) - state)[0].max()) > _PATH_TOLERANCE
        self._followed = message.number, trajectory

    def on_speed(self, state: ExecutorState) -> None:
        """Take the robot's share of the planned speed."""
        self._clock.set_speed(state.speed_scale, clock.monotonic())

    def state(self) -> ServoSession:
        """The session's current state."""
        snapshot = self._snapshot
        limitation = snapshot.limitation
        position = self._measured_position()
        near = self._scene.nearby(position, clock.monotonic(), self._clock.scale)
        link, other = limitation.pair or (None, None)
        took = list(self._took)
        return ServoSession(
            goal_id=self.goal_id,
            limiting=limitation.kind,
            link=link,
            object=other,
            distance=limitation.distance,
            clearance=next((pair.distance for pair in near if pair.kept_margin >= self._margin), None),
            moving=snapshot.moving,
            sequence=self.inbox.sequence,
            target_age=snapshot.age,
            refused=self.inbox.refused,
            planned=self._local_goal.planned,
            unreachable=self._local_goal.problem,
            cycles=self._cycles,
            late_cycles=self._late,
            computing=float(np.percentile(took, 99)) if took else 0.0,
            chunk=self._chunk_tracking.sequence,
            lag=self._chunk_tracking.lag(),
            **self._errors(snapshot, position),
        )

    def _errors(self, snapshot: Snapshot, position: Array) -> dict[str, float]:
        target = snapshot.target
        if isinstance(target, JointTarget):
            return {"joint_error": float(np.abs(target.distance(self._model, position)).max())}
        if not isinstance(target, PoseTarget):
            return {}
        error = target.error(self._model.fk_tip(position, target.group), target.after(snapshot.age or 0.0))
        return {
            "position_error": float(np.linalg.norm(error[:3])),
            "orientation_error": float(np.linalg.norm(error[3:])),
        }

    def _measured_position(self) -> Array:
        measured = self._measured.get()
        if measured is None or set(measured.joint_names) != set(self._joints):
            return np.asarray(self._controller.state[0])
        return np.array([measured.position[measured.joint_names.index(joint)] for joint in self._joints])

    def take(self, chunk: ServoChunk) -> ChunkAccepted:
        """Take a chunk. Raises InvalidRequest, see `ChunkInbox.receive`."""
        return self._chunk_tracking.take(chunk, self._snapshot.limitation)

    # -- the thread --

    def _run(self) -> None:
        ask_for_realtime(_PRIORITY)
        try:
            due = clock.monotonic()
            while self._goes_on():
                clock.sleep(max(0.0, due - clock.monotonic()))
                now = clock.monotonic()
                self._cycles += 1
                if now - due > _LATE_CYCLE:
                    self._late += 1
                    self._metrics.count("zarm_servo_late_cycles", "Cycles of sessions that began more than 2 ms late.")
                self._cycle(now)
                took = clock.monotonic() - now
                self._took.append(took)
                self._metrics.time("zarm_servo_cycle_seconds", "How long cycles of sessions took.", took)
                due = max(due + (_CATCH_UP_PERIOD if self._behind(now) else PERIOD), now)
        except Exception:
            log.exception("the session failed; the robot is brought to rest goal_id=%s", self.goal_id)
        finally:
            self._end()

    def _goes_on(self) -> bool:
        goal = self._goal
        if self._held or (goal is not None and goal.done):
            return False
        if clock.monotonic() - self._received_at > _EXECUTOR_TIMEOUT:
            log.warning("the executor reports nothing about the session goal_id=%s", self.goal_id)
            return False
        return not self._closing or self._snapshot.moving

    def _cycle(self, now: float) -> None:
        self._scene.look(now)
        target, age = self.inbox.newest(now)
        if self._chunk_tracking.active(now) or (target is not None and age is not None and age <= STALE):
            self._used = now
        elif now - self._used > _IDLE_TIMEOUT:
            log.info("the session ends, no targets arrive seconds=%g goal_id=%s", _IDLE_TIMEOUT, self.goal_id)
            self._closing = True
        if self._off_path and not self._rejoin_path(self._clock.time(now), now):
            return
        if self._behind(now):
            self._step(None if self._closing else target, age, max(self._coming(now), 0.0))
        if self._streamed.pending >= CHUNK or now - self._sent_at > _LONGEST_CHUNK_PERIOD:
            self._put(*self._streamed.chunk())
            self._chunk_tracking.learn_lag()

    def _coming(self, now: float) -> float:
        """In how long (s) from `now` on the next step is commanded."""
        return self._streamed.time + PERIOD - self._clock.time(now)

    def _behind(self, now: float) -> bool:
        return self._coming(now) <= LEAD

    def _rejoin_path(self, commanded: float, now: float) -> bool:
        """Continue from the trajectory that the executor follows, once it has taken all chunks; returns whether this
        was possible.
        """
        followed = self._followed
        if followed is None or (followed[0] < self._sequence and now - self._sent_at < _CHUNK_TIMEOUT):
            return False
        time_there = commanded + LEAD
        state = followed[1].at(time_there)
        if time_there >= followed[1].duration:
            state[1:] = 0.0
        self._controller.restart(state)
        self._streamed = StreamedTrajectory(time_there, self._controller.state, self._controller.braking)
        self._off_path = False
        return True

    def _step(self, target: Target | None, age: float | None, coming: float) -> None:
        now, scale = clock.monotonic(), self._clock.scale
        around = self._scene.around(now, coming + self._delay + self._lag.seconds, scale)
        step = None
        if not self._closing:
            expected = now + coming / scale + self._delay
            step = self._chunk_tracking.step(expected, 1.0 / scale, around, self._snapshot.limitation)
        if step is None:
            step = self._towards(target, age, coming, around)
        self._streamed.add(step)
        before = self._snapshot.limitation
        moving = bool(np.abs(step.state[1]).max() > _MOVING_SPEED)
        self._snapshot = Snapshot(step.limitation, target, age, moving)
        now = clock.monotonic()
        if (before.kind, before.pair) != (
            step.limitation.kind,
            step.limitation.pair,
        ) and now - self._reported_at > _REPORT_PERIOD:
            self._reported_at = now
            self._changed()

    def _towards(self, target: Target | None, age: float | None, coming: float, around: Surroundings) -> Step:
        """A step towards a live target, or to rest."""
        fresh = target is not None and age is not None and age <= STALE
        wanted = ahead(target, coming + self._delay) if target is not None and fresh else None
        wanted = self._local_goal.target(wanted, self._controller.state[0], self._scene.revision)
        return self._controller.step(wanted, age or 0.0, around)

    def _put(
        self, start: float, trajectory: TimedTrajectory, *, deadline: float = DEADLINE, last: bool = False
    ) -> None:
        self._sequence += 1
        self._sent_at = clock.monotonic()
        self._ends[self._sequence] = self._streamed.time, self._controller.state
        if len(self._ends) > _CHUNKS_KEPT:
            self._ends.popitem(last=False)
        self._chunks.put(
            StreamChunk(
                goal_id=self.goal_id,
                sequence=self._sequence,
                start=start,
                trajectory=trajectory.message(self._joints),
                deadline=deadline,
                last=last,
            )
        )

    def _end(self) -> None:
        """End the goal at the executor where the robot comes to rest; a paused goal is left as it is."""
        self._pool.shutdown(wait=False, cancel_futures=True)
        goal = self._goal
        if not self._held and not (goal is not None and goal.done):
            self._put(*self._streamed.chunk(), last=True)
            deadline = clock.monotonic() + _REST_TIMEOUT
            while not (self._goal is not None and self._goal.done) and clock.monotonic() < deadline:
                self._reported.clear()
                self._reported.wait(0.1)
        goal = self._goal
        problem = None if goal is None else goal.problem
        log.info("session ended goal_id=%s reason=%s", self.goal_id, "" if problem is None else problem.message)
        self._scene.close()
        self._done.set()
        self._changed()


def soft(limits: Limits) -> Limits:
    """The limits for steps, such that the quintics of a chunk stay inside `limits` between samples too."""
    acceleration = _ACCELERATION_SHARE * limits.acceleration
    return replace(limits, acceleration=acceleration, jerk=np.minimum(limits.jerk, acceleration / _ACCELERATION_TIME))
