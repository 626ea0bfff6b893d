"""Attacks on a guarded robot, in one process: an object approaches the arm, using the classes of the servo and of the
executor.

The servo's guard or session, the executor's state machine and its follower are the real ones; the clock is simulated,
messages take some milliseconds, and the arm follows exactly or `lag` s later. python-fcl detects contact on the descriptor's shapes.
"""

from __future__ import annotations

import heapq
import itertools
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, Literal, get_args

import numpy as np
import pytest

from support.arrivals import arrival
from support.executor.bench import LIMITS, Bench
from support.planner.second_opinion import Clearance, link_pose
from support.trajectories import ROBOT, SCENE, rest_to_rest
from zarm_contract.codec import encode
from zarm_contract.errors import Unavailable
from zarm_contract.messages import (
    Cuboid,
    GoalState,
    GoalTrajectory,
    JointPoints,
    JointState,
    ObjectPose,
    Plan,
    PlanRequest,
    Scene,
    ServoChunk,
    ServoStart,
    ServoTarget,
    Sphere,
)
from zarm_contract.messages import JointTarget as JointTargetMessage
from zarm_executor.goal import Chunk, Goal
from zarm_executor.monitor import Monitor
from zarm_executor.strategies.base import Measured
from zarm_geometry.meshes import Meshes
from zarm_geometry.robot_model import RobotModel
from zarm_runtime.metrics import Metrics
from zarm_servo.guarding import guard as guard_module
from zarm_servo.guarding.guard import Guard
from zarm_servo.tracking import chunk_tracking as chunk_module
from zarm_servo.tracking import session as session_module
from zarm_servo.tracking.session import Session, SessionConfig
from zarm_servo.world.check import Checker, SceneCheck
from zarm_servo.world.world_monitor import WorldMonitor
from zarm_trajectory.blending import blended
from zarm_trajectory.trajectory import TimedTrajectory

Array = np.ndarray[Any, Any]
Mode = Literal["goal", "session", "chunks"]
MODES: tuple[Mode, ...] = get_args(Mode)
Outcome = Literal["contact", "hit", "free"]
"""`contact`: while the robot moved towards the object. `hit`: the object hit a robot that did not move towards it.
`free`: neither.
"""

STEP = 0.002
"""Time step (s) of the clock."""
_TICK, _CYCLE, _LOOK = 5, 2, 8
_JOINTS = ROBOT.descriptor.joints
_LINKS = tuple(f"link_{k}" for k in range(2, 7))
_TOWARDS = 2e-5
"""A step of 10 ms that reduces the distance to the stationary object by less than this (m) is not towards it: 2 mm/s.
"""
_FASTEST = 6.0
"""Nothing here is faster (m/s): distant objects are checked again only when they may have come close."""
_RESTS = 0.5
"""A run ends when the robot has stood for this long (s)."""
_MOVES = 0.002
"""A robot whose joints are slower than this (rad/s) stands."""
_UNIX = 1.75e9
MODEL, MESHES = RobotModel.of(ROBOT), Meshes()


@dataclass(frozen=True)
class Attack:
    """The result of an attack, and the smallest distance (m) of the robot to the object."""

    outcome: Outcome
    clearance: float
    held: bool
    moved: bool
    killed: bool
    arrived: bool


class Cell:
    """Shared by all attacks: kernels and bodies that are loaded once."""

    def __init__(self) -> None:
        self.checker, self.check = Checker(MODEL, MESHES), SceneCheck(MODEL, MESHES)

    def attack(self, seed: int, mode: Mode, lag: float = 0.0) -> Attack:
        """The attack with this seed on an arm that is `lag` s behind its commands."""
        with _clock() as clock:
            return _Run(self, np.random.default_rng(seed), mode, clock, lag).result()


@contextmanager
def _clock() -> Iterator[SimpleNamespace]:
    """The clocks of guard and session, as `now` of the monotonic one."""
    clock = SimpleNamespace(now=100.0)
    turned = SimpleNamespace(
        monotonic=lambda: clock.now,
        unix_time=lambda: _UNIX + clock.now,
        sleep=lambda _: None,
    )
    with pytest.MonkeyPatch.context() as patch:
        for module in (guard_module, session_module, chunk_module):
            patch.setattr(module, "clock", turned)
        yield clock


def _no_plan(_: PlanRequest) -> Plan:
    raise Unavailable("here is no planner")


class _Run:
    def __init__(
        self, cell: Cell, rng: np.random.Generator, mode: Mode, clock: SimpleNamespace, lag: float = 0.0
    ) -> None:
        self._rng, self._mode, self._time = rng, mode, clock
        dies = rng.random() < 0.3
        guard = "required" if mode == "goal" and dies else "optional"
        execution = ROBOT.descriptor.execution.model_copy(update={"guard": guard, "guard_timeout": 0.2})
        robot = ROBOT.descriptor.model_copy(update={"execution": execution})
        self._bench = Bench(now=clock.now, robot=robot)
        self._bench.machine.scene = SCENE
        self._mail: list[tuple[float, int, Callable[[], None]]] = []
        self._count = itertools.count()
        start, goal = self._ends()
        self._bench.arm.follower.trajectory = TimedTrajectory.standing(start)
        self._bench.arm.exact = type(self._bench.arm.exact)(start, np.zeros(6), clock.now)
        ticks = 1 + round(lag / (_TICK * STEP))
        self._passed = deque([self._bench.arm.exact] * ticks, maxlen=ticks)
        self._bench.arm.disturb = self._late
        self._start, self._goal = start, goal
        self._object(start)
        measured: Any = SimpleNamespace(get=lambda max_age=1.0: self._measured())
        authorities: Any = SimpleNamespace(put=lambda said: self._post(lambda: self._hear(said)))
        nothing: Any = SimpleNamespace(set=lambda _: None)
        self._world = WorldMonitor(measured, MESHES, ROBOT.descriptor)
        self._world.lag.on_goal(GoalState.model_construct(lag=lag))  # as it was in the motion before
        self._guard = Guard(
            robot,
            cell.checker,
            self._world,
            authorities,
            nothing,
            "servo",
            Metrics(),
            session=lambda: None,
            validity=lambda *_: None,
            collision_detection=lambda: "off",
        )
        self._world.scene.on_scene("", Scene(revision=SCENE, objects=(self._item,)))
        self._killed_at = clock.now + rng.uniform(0.1, 2.5) if dies else np.inf
        self._due = clock.now
        self._tell_pose(at_once=True)
        self._longest = 6.0 if mode == "goal" else 3.0
        self._session: Session | None = None
        self._sequence = itertools.count(1)
        if mode != "goal":
            chunks: Any = SimpleNamespace(put=lambda chunk: self._post(lambda: self._stream(chunk)))
            self._session = Session(
                "servo-1", ServoStart(margin=0.01), SessionConfig(ROBOT, cell.check, self._world, chunks, _no_plan, lambda _: None, Metrics(), lambda: None),
                start, 0.0,
            )  # fmt: skip
            self._session._put(0.0, TimedTrajectory.standing(start), deadline=1.0)
        else:
            self._begin_goal()

    # -- the robot --

    def _ends(self) -> tuple[Array, Array]:
        """Start and end of the robot's motion: far enough apart, and away from the joint limits."""
        home = np.array(ROBOT.descriptor.home)
        start = home + self._rng.uniform(-0.5, 0.5, 6)
        goal = start.copy()
        goal[0] += self._rng.choice((-1.0, 1.0)) * self._rng.uniform(0.8, 2.0)
        goal[1:] += self._rng.uniform(-0.4, 0.4, 5)
        return start, np.clip(goal, MODEL.lower + 0.1, MODEL.upper - 0.1)

    def _begin_goal(self) -> None:
        message = rest_to_rest(self._goal, self._start, slower=float(self._rng.uniform(1.0, 2.0)))
        trajectory = TimedTrajectory.of(message, _JOINTS)
        goal = Goal("goal-1", None, trajectory, Monitor(trajectory, self._bench.robot), SCENE)
        reported = GoalTrajectory(goal_id="goal-1", number=1, start=0.0, trajectory=message, scene_revision=SCENE)
        self._guard.on_trajectory(reported)
        self._guard._goals._running = "goal-1"
        self._guard._check()
        while self._mail:
            heapq.heappop(self._mail)[2]()
        self._bench.machine.start(goal, arrival())

    def _late(self, exact: Measured) -> Measured:
        """Where an arm is that is behind one that would be in this state."""
        if self._passed[-1] is not exact:
            self._passed.append(exact)
        return replace(self._passed[0], time=exact.time)

    def _measured(self) -> JointState:
        arm = self._passed[0]
        return JointState(
            stamp=self._time.now, joint_names=_JOINTS, position=tuple(arm.position.tolist()), velocity=tuple(arm.velocity.tolist())
        )  # fmt: skip

    def _hear(self, said: Any) -> None:
        self._bench.machine.receive(said, self._time.now)

    def _stream(self, chunk: Any) -> None:
        machine = self._bench.machine
        trajectory = TimedTrajectory.of(chunk.trajectory, _JOINTS)
        piece = Chunk(chunk.sequence, chunk.start, trajectory, self._time.now, chunk.deadline, chunk.last, scene=SCENE)
        if chunk.sequence == 1:
            path = blended(TimedTrajectory.standing(self._bench.arm.exact.position), 0.0, trajectory, 0.0, LIMITS)
            goal = Goal("servo-1", None, path, Monitor(path, ROBOT.descriptor), SCENE, chunk=piece)
            machine.start(goal, arrival())
        else:
            goal = machine.steer("servo-1", piece, LIMITS)
        if goal is not None and self._session is not None:
            followed, session = goal.followed(_JOINTS), self._session
            self._post(lambda: session.on_trajectory(followed))

    # -- the object --

    def _object(self, start: Array) -> None:
        """An object with a reported velocity, whose true one may be anything within the stated speed of that."""
        rng = self._rng
        self._speed = float(rng.uniform(0.05, 1.0)) ** 2
        self._reported = self._direction() * rng.uniform(0.0, 0.4) if rng.random() < 0.4 else np.zeros(3)
        self._period, self._delay = float(rng.uniform(0.01, 0.05)), float(rng.uniform(0.001, 0.03))
        self._offset = float(rng.uniform(-0.018, 0.018))
        if rng.random() < 0.5:
            item: Sphere | Cuboid = Sphere(
                kind="sphere", name="box", position=(0.0, 0.0, 5.0), radius=float(rng.uniform(0.03, 0.15))
            )
        else:
            x, y, z = rng.uniform(0.05, 0.3, 3).tolist()
            item = Cuboid(kind="cuboid", name="box", position=(0.0, 0.0, 5.0), size=(x, y, z))
        self._item, self._clearance = item, Clearance(ROBOT, item)
        least = rng.uniform(0.05, 0.6)
        while True:  # around the arm, often in front of its path
            at = self._tip(start + rng.uniform(0.0, 1.0) * (self._goal - start)) + rng.normal(0.0, 0.4, 3)
            if self._clearance.at(start, at) > least:
                break
        self._at: Array = at
        self._aim, self._share, self._velocity = "link_6", float(rng.choice((0.0, 1.0))), self._reported

    def _direction(self) -> Array:
        way = self._rng.normal(size=3)
        return np.asarray(way / np.linalg.norm(way))

    def _tip(self, q: Array) -> Array:
        return np.asarray(link_pose(ROBOT, ROBOT.descriptor.tip_link, q)[:3, 3])

    def _turn_object(self) -> None:
        """Steer it towards the arm, mostly at the stated speed: at where a link is, or will be soon."""
        rng = self._rng
        if rng.random() < 0.02:
            self._aim, self._share = str(rng.choice(_LINKS)), float(rng.choice((1.0, 1.0, 1.0, 0.0, -1.0)))
        arm = self._passed[0]
        links = MODEL.link_transforms(arm.position + rng.uniform(0.0, 0.5) * arm.velocity)
        away = links[MODEL.links.index(self._aim), :3, 3] - self._at
        way = away / max(float(np.linalg.norm(away)), 1e-9)
        self._velocity = self._reported + self._share * self._speed * way

    def _tell_pose(self, *, at_once: bool = False) -> None:
        message = ObjectPose(
            stamp=_UNIX + self._time.now + self._offset,
            position=tuple(self._at.tolist()),
            linear=tuple(self._reported.tolist()),
            speed=self._speed,
        )
        payload = encode(message)

        def update_object() -> None:
            self._world.moving.update_object("box", payload, self._time.now, _UNIX + self._time.now)

        if at_once:
            update_object()
        else:
            self._post(update_object, self._delay)

    # -- time --

    def _post(self, deliver: Callable[[], None], delay: float | None = None) -> None:
        """Deliver a message some milliseconds later."""
        late = float(self._rng.uniform(0.001, 0.006)) if delay is None else delay
        heapq.heappush(self._mail, (self._time.now + late, next(self._count), deliver))

    def result(self) -> Attack:
        """Run the attack."""
        bench, clock = self._bench, self._time
        before, place = self._start, self._at
        nearest, held, moved, reported, skipped, rested = np.inf, False, False, None, 0, 0
        outcome: Outcome = "free"
        for step in itertools.count(1):
            clock.now += STEP
            alive = clock.now < self._killed_at
            while self._mail and self._mail[0][0] <= clock.now:
                heapq.heappop(self._mail)[2]()
            if clock.now >= self._due:
                self._due = clock.now + self._period
                self._tell_pose()
            if alive:
                self._servo(step)
            self._at = self._at + STEP * self._velocity
            if step % _TICK:
                continue
            self._turn_object()
            bench.now = clock.now
            bench.machine.tick(clock.now)
            goal = bench.machine.changes[-1] if bench.machine.changes else None
            if goal is not None:
                held = held or goal.hold is not None
                if goal is not reported or step % (5 * _TICK) == 0:
                    reported = goal
                    self._tell_goal(bench.machine.goal_state() or goal)
            now, velocity = self._passed[0].position, self._passed[0].velocity
            moved = moved or bool(np.abs(now - self._start).max() > 0.05)
            rested = 0 if np.abs(velocity).max() > _MOVES else rested + 1
            over = rested * _TICK * STEP > _RESTS or step * STEP > self._longest or (goal is not None and goal.done)
            if skipped > 0 and not over:
                skipped -= 1
                continue
            apart = self._clearance.at(now, self._at)
            skipped = int(apart / (_FASTEST * _TICK * STEP))
            nearest = min(nearest, apart)
            if apart <= 0.0:
                closer = self._clearance.at(before, place) - self._clearance.at(now, place)
                outcome = "contact" if closer > _TOWARDS else "hit"
                break
            before, place = now, self._at
            if over:
                break
        if self._session is not None:
            self._session._pool.shutdown()
        arrived = bool(np.abs(self._passed[0].position - self._goal).max() < 0.01)
        return Attack(outcome, float(nearest), held, moved, self._killed_at < clock.now, arrived)

    def _tell_goal(self, goal: GoalState) -> None:
        session, guard = self._session, self._guard
        heard = guard.on_goal if session is None else session.on_goal
        self._post(lambda: (self._world.lag.on_goal(goal), heard(goal)))

    def _servo(self, step: int) -> None:
        session = self._session
        if session is None:
            if step % _LOOK == 0:
                self._guard._check()
        elif step % _CYCLE == 0:
            if self._mode == "chunks":
                if step % 16 == 0:  # 30 a second
                    session.take(self._chunk())
            elif step % 10 == 0:
                target = JointTargetMessage(kind="joints", position=tuple(self._goal.tolist()))
                message = ServoTarget(
                    goal_id="servo-1", sequence=next(self._sequence), stamp=self._time.now, target=target
                )
                session.inbox.receive(message, self._time.now)
            session._cycle(self._time.now)
            session._scene.catch_up()

    def _chunk(self) -> ServoChunk:
        """What a policy that sees no object plans: straight to the goal, at 1 rad/s."""
        here = self._bench.arm.exact.position
        way = self._goal - here
        shares = np.minimum(np.arange(30) / 30 / max(float(np.abs(way).max()), 1e-6), 1.0)
        rows = here + shares[:, None] * way
        return ServoChunk(
            goal_id="servo-1",
            sequence=next(self._sequence),
            stamp=_UNIX + self._time.now,
            dt=1 / 30,
            points=JointPoints(kind="joints", position=tuple(map(tuple, rows.tolist()))),
        )
