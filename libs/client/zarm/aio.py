"""The same client for asyncio: the methods of `zarm.Robot` and `zarm.Scene` are awaited, iterators and blocks are `async`.

```python
async with zarm.aio.connect() as robot:
    plan = await robot.plan(zarm.Pose((0.5, 0.2, 0.4), (0, 1, 0, 0)))
    await robot.execute(plan)
```

Each call is done by a thread of its own. A task that is cancelled in `execute` or in a `stream` cancels the goal and goes on
once the robot rests; where it is cancelled once more it does not wait. `on_progress` is called in the event loop.
"""

from __future__ import annotations

import asyncio
import functools
from collections.abc import AsyncIterator, Callable, Coroutine, Generator
from concurrent.futures import Future
from contextlib import AbstractAsyncContextManager, AbstractContextManager, asynccontextmanager, suppress
from dataclasses import replace
from typing import (
    TYPE_CHECKING,
    Any,
    Concatenate,
    Generic,
    Literal,
    ParamSpec,
    Protocol,
    TypeVar,
    Unpack,
    cast,
    overload,
)

import zarm.connection
import zarm.gripper
import zarm.outputs
import zarm.perception
import zarm.replaying
import zarm.robot
import zarm.scene
import zarm.servoing
import zarm.simulation
from zarm.connection import CONNECT_SECONDS, Connection
from zarm.executor import OnProgress
from zarm.interrupts import Interruption, started
from zarm.record_story import Story
from zarm_contract.messages import ExecuteRequest, GoalState, Plan, ServoSession, Trajectory
from zarm_contract.roles import Role

if TYPE_CHECKING:
    from zarm.servo import SessionOptions
    from zarm.servoing import Tracking

__all__ = [
    "ChunkTracking",
    "Gripper",
    "Outputs",
    "Perception",
    "Robot",
    "Scene",
    "Simulation",
    "connect",
    "replay",
    "robots",
    "story",
]

P = ParamSpec("P")
T = TypeVar("T")
S = TypeVar("S")


async def _in_thread(work: Callable[[], T], interruption: Interruption) -> T:
    """The result or exception of `work`. Its waits are interrupted when the task is cancelled, which then waits for its
    end.
    """
    loop, done = asyncio.get_running_loop(), asyncio.Event()

    def wake() -> None:
        with suppress(RuntimeError):  # the loop has ended without waiting for this
            loop.call_soon_threadsafe(done.set)

    future, _ = started(work, wake)
    try:
        await done.wait()
    except asyncio.CancelledError:
        interruption.interrupt()
        await done.wait()
        raise
    return future.result()


class _Twin(Generic[S]):
    """The asynchronous twin of what `make` makes of a connection."""

    def __init__(self, make: Callable[[Connection], S], connection: Connection) -> None:
        self.connection = connection
        self._make = make

    def _interrupted_by(self, interruption: Interruption) -> S:
        return self._make(replace(self.connection, interrupts=interruption))


def _awaited(method: Callable[Concatenate[Any, P], T]) -> Callable[Concatenate[Any, P], Coroutine[Any, Any, T]]:
    @functools.wraps(method)
    async def call(self: _Twin[Any], /, *args: P.args, **kwargs: P.kwargs) -> T:
        interruption = Interruption()
        return await _in_thread(lambda: method(self._interrupted_by(interruption), *args, **kwargs), interruption)

    return call


def _iterated(
    method: Callable[Concatenate[Any, P], Generator[T]],
) -> Callable[Concatenate[Any, P], AsyncIterator[T]]:
    @functools.wraps(method)
    async def iterate(self: _Twin[Any], /, *args: P.args, **kwargs: P.kwargs) -> AsyncIterator[T]:
        interruption = Interruption()
        values = method(self._interrupted_by(interruption), *args, **kwargs)
        try:
            while (value := await _in_thread(lambda: next(values, None), interruption)) is not None:
                yield value
        finally:
            with suppress(ValueError):  # a task that did not wait for its thread leaves it as it is
                values.close()

    return iterate


def _in_session(
    method: Callable[Concatenate[zarm.servoing.ChunkTracking, P], T],
) -> Callable[Concatenate[ChunkTracking, P], Coroutine[Any, Any, T]]:
    @functools.wraps(method)
    async def call(self: ChunkTracking, /, *args: P.args, **kwargs: P.kwargs) -> T:
        return await _in_thread(lambda: method(self.session, *args, **kwargs), Interruption())

    return call


class ChunkTracking:
    """See `zarm.ChunkTracking`."""

    def __init__(self, session: zarm.servoing.ChunkTracking) -> None:
        self.session = session

    @property
    def goal_id(self) -> str:
        """The goal of the executor that this session is."""
        return self.session.goal_id

    @property
    def state(self) -> ServoSession | None:
        """The session's last state. None before the first one."""
        return self.session.state

    @property
    def running(self) -> bool:
        """Whether the session has not ended yet."""
        return self.session.running

    follow = _in_session(zarm.servoing.ChunkTracking.follow)


class Track(Protocol):
    """The types of `Robot.track`."""

    @overload
    def __call__(
        self, *, chunks: Literal[False] = False, **options: Unpack[SessionOptions]
    ) -> AbstractAsyncContextManager[Tracking]: ...

    @overload
    def __call__(
        self, *, chunks: Literal[True], **options: Unpack[SessionOptions]
    ) -> AbstractAsyncContextManager[ChunkTracking]: ...


def _entered(
    method: Callable[Concatenate[Any, P], AbstractContextManager[T]],
) -> Callable[Concatenate[Any, P], AbstractAsyncContextManager[T]]:
    @asynccontextmanager
    @functools.wraps(method)
    async def enter(self: _Twin[Any], /, *args: P.args, **kwargs: P.kwargs) -> AsyncIterator[T]:
        interruption = Interruption()
        block = await _in_thread(lambda: method(self._interrupted_by(interruption), *args, **kwargs), interruption)
        async with _block(block, interruption) as value:
            yield value

    return enter


@asynccontextmanager
async def _block(block: AbstractContextManager[T], interruption: Interruption) -> AsyncIterator[T]:
    value = await _in_thread(block.__enter__, interruption)
    try:
        yield value
    except BaseException as error:
        leave = functools.partial(block.__exit__, type(error), error, error.__traceback__)
        if not await _in_thread(leave, interruption):
            raise
    else:
        await _in_thread(lambda: block.__exit__(None, None, None), interruption)


def _reported_in_loop(on_progress: OnProgress | None) -> OnProgress | None:
    if on_progress is None:
        return None
    loop, wake = asyncio.get_running_loop(), on_progress

    def progress(state: GoalState) -> None:
        finished: Future[None] = Future()

        def call() -> None:
            try:
                wake(state)
                finished.set_result(None)
            except Exception as error:  # raised where the goal is followed, which stops the robot
                finished.set_exception(error)

        loop.call_soon_threadsafe(call)
        finished.result()

    return progress


class Scene(_Twin[zarm.scene.Scene]):
    """See `zarm.Scene`."""

    def __init__(self, connection: Connection) -> None:
        super().__init__(zarm.scene.Scene, connection)

    add = _awaited(zarm.scene.Scene.add)
    remove = _awaited(zarm.scene.Scene.remove)
    clear = _awaited(zarm.scene.Scene.clear)
    attach = _awaited(zarm.scene.Scene.attach)
    detach = _awaited(zarm.scene.Scene.detach)
    mount = _awaited(zarm.scene.Scene.mount)
    unmount = _awaited(zarm.scene.Scene.unmount)
    set_link_collision = _awaited(zarm.scene.Scene.set_link_collision)
    set_object_collision = _awaited(zarm.scene.Scene.set_object_collision)
    set_pair_collision = _awaited(zarm.scene.Scene.set_pair_collision)
    move = _awaited(zarm.scene.Scene.move)
    load = _awaited(zarm.scene.Scene.load)
    save = _awaited(zarm.scene.Scene.save)
    objects = _awaited(zarm.scene.Scene.objects)
    attached = _awaited(zarm.scene.Scene.attached)
    read = _awaited(zarm.scene.Scene.read)
    occupancy = _awaited(zarm.scene.Scene.occupancy)
    apply = _awaited(zarm.scene.Scene.apply)


class Gripper(_Twin[zarm.gripper.Gripper]):
    """See `zarm.Gripper`."""

    def __init__(self, connection: Connection) -> None:
        super().__init__(zarm.gripper.Gripper, connection)

    open = _awaited(zarm.gripper.Gripper.open)
    close = _awaited(zarm.gripper.Gripper.close)
    move = _awaited(zarm.gripper.Gripper.move)
    cancel = _awaited(zarm.gripper.Gripper.cancel)
    all = _awaited(zarm.gripper.Gripper.all)
    state = _awaited(zarm.gripper.Gripper.state)
    states = _iterated(zarm.gripper.Gripper.states)


class Outputs(_Twin[zarm.outputs.Outputs]):
    """See `zarm.Outputs`."""

    def __init__(self, connection: Connection) -> None:
        super().__init__(zarm.outputs.Outputs, connection)

    set = _awaited(zarm.outputs.Outputs.set)
    all = _awaited(zarm.outputs.Outputs.all)
    states = _iterated(zarm.outputs.Outputs.states)


class Perception(_Twin[zarm.perception.Perception]):
    """See `zarm.Perception`."""

    def __init__(self, connection: Connection) -> None:
        super().__init__(zarm.perception.Perception, connection)

    cameras = _awaited(zarm.perception.Perception.cameras)
    add = _awaited(zarm.perception.Perception.add)
    remove = _awaited(zarm.perception.Perception.remove)
    publish = _awaited(zarm.perception.Perception.publish)
    publish_cloud = _awaited(zarm.perception.Perception.publish_cloud)
    look = _awaited(zarm.perception.Perception.look)
    boxes = _awaited(zarm.perception.Perception.boxes)
    save = _awaited(zarm.perception.Perception.save)
    load = _awaited(zarm.perception.Perception.load)
    points = _awaited(zarm.perception.Perception.points)
    clear = _awaited(zarm.perception.Perception.clear)
    state = _awaited(zarm.perception.Perception.state)


class Simulation(_Twin[zarm.simulation.Simulation]):
    """See `zarm.Simulation`."""

    def __init__(self, connection: Connection) -> None:
        super().__init__(zarm.simulation.Simulation, connection)

    load = _awaited(zarm.simulation.Simulation.load)
    state = _awaited(zarm.simulation.Simulation.state)


class Robot(_Twin[zarm.robot.Robot]):
    """See `zarm.Robot`."""

    def __init__(self, connection: Connection) -> None:
        super().__init__(zarm.robot.Robot, connection)
        self.scene = Scene(connection)
        self.gripper = Gripper(connection)
        self.outputs = Outputs(connection)
        self.perception = Perception(connection)
        self.simulation = Simulation(connection)

    @property
    def name(self) -> str:
        """Its name on the bus."""
        return self.connection.keys.robot

    plan = _awaited(zarm.robot.Robot.plan)
    request_plan = _awaited(zarm.robot.Robot.request_plan)
    plan_program = _awaited(zarm.robot.Robot.plan_program)
    request_program = _awaited(zarm.robot.Robot.request_program)
    cancel_plan = _awaited(zarm.robot.Robot.cancel_plan)
    settings = _awaited(zarm.robot.Robot.settings)
    fk = _awaited(zarm.robot.Robot.fk)
    ik = _awaited(zarm.robot.Robot.ik)
    request_ik = _awaited(zarm.robot.Robot.request_ik)
    inverse_dynamics = _awaited(zarm.robot.Robot.inverse_dynamics)
    check = _awaited(zarm.robot.Robot.check)
    start = _awaited(zarm.robot.Robot.start)
    cancel = _awaited(zarm.robot.Robot.cancel)
    stop = _awaited(zarm.robot.Robot.stop)
    pause = _awaited(zarm.robot.Robot.pause)
    resume = _awaited(zarm.robot.Robot.resume)
    reset = _awaited(zarm.robot.Robot.reset)
    speed = _awaited(zarm.robot.Robot.speed)
    strategy = _awaited(zarm.robot.Robot.strategy)
    state = _awaited(zarm.robot.Robot.state)
    joint_state = _awaited(zarm.robot.Robot.joint_state)
    take_over = _awaited(zarm.robot.Robot.take_over)
    execute_alongside = _awaited(zarm.robot.Robot.execute_alongside)
    tip = _awaited(zarm.robot.Robot.tip)
    health = _awaited(zarm.robot.Robot.health)
    joint_dynamics = _awaited(zarm.robot.Robot.joint_dynamics)
    pick = _awaited(zarm.robot.Robot.pick)
    place = _awaited(zarm.robot.Robot.place)
    goal_states = _iterated(zarm.robot.Robot.goal_states)
    states = _iterated(zarm.robot.Robot.states)
    joint_states = _iterated(zarm.robot.Robot.joint_states)
    stream = _entered(zarm.robot.Robot.stream)
    _entered_track = _entered(cast("Any", zarm.robot.Robot.track))

    @asynccontextmanager
    async def _track(self, *, chunks: bool = False, **options: Any) -> AsyncIterator[Tracking | ChunkTracking]:
        async with self._entered_track(chunks=chunks, **options) as session:
            yield ChunkTracking(session) if chunks else session

    track = cast("Track", _track)
    jog = _entered(zarm.robot.Robot.jog)
    record = _entered(zarm.robot.Robot.record)
    _execute = _awaited(zarm.robot.Robot.execute)
    _follow = _awaited(zarm.robot.Robot.follow)

    async def execute(
        self,
        what: Plan | Trajectory | ExecuteRequest | str | None = None,
        *,
        preempt: bool = False,
        replan: bool = False,
        on_progress: OnProgress | None = None,
    ) -> GoalState:
        """See `zarm.Robot.execute`."""
        return await self._execute(what, preempt=preempt, replan=replan, on_progress=_reported_in_loop(on_progress))

    async def follow(
        self, goal_id: str, on_progress: OnProgress | None = None, *, timeout: float | None = None
    ) -> GoalState:
        """See `zarm.Robot.follow`."""
        return await self._follow(goal_id, _reported_in_loop(on_progress), timeout=timeout)


@asynccontextmanager
async def connect(
    endpoint: str | None = None,
    name: str | None = None,
    *,
    role: Role | None = None,
    timeout: float = CONNECT_SECONDS,
) -> AsyncIterator[Robot]:
    """See `zarm.connect`."""
    connected = zarm.connection.connected(endpoint, name, role=role, timeout=timeout)
    async with _block(connected, Interruption()) as connection:
        yield Robot(connection)


async def robots(endpoint: str | None = None, *, role: Role | None = None) -> list[str]:
    """See `zarm.robots`."""
    return await _in_thread(lambda: zarm.connection.robots(endpoint, role=role), Interruption())


async def replay(
    file: str, name: str, *, speed: float = 1.0, endpoint: str | None = None, role: Role | None = None
) -> int:
    """See `zarm.replay`."""
    waits = Interruption()
    return await _in_thread(
        lambda: zarm.replaying.replay(file, name, speed=speed, endpoint=endpoint, role=role, interrupts=waits), waits
    )


async def story(file: str) -> Story:
    """See `zarm.story`."""
    waits = Interruption()
    return await _in_thread(lambda: zarm.replaying.story(file, interrupts=waits), waits)
