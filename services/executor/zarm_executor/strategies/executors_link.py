"""The bus between an executor and those of the robots of which its own consists: streams out, joint states in."""

from __future__ import annotations

import secrets
import threading
from collections.abc import Iterator, Sequence

import numpy as np

from zarm_contract.descriptor import CommandTiming, RobotDescriptor
from zarm_contract.keys import Keys
from zarm_contract.messages import ExecutorState, GoalState, StreamChunk
from zarm_executor.strategies.base import Measured
from zarm_executor.strategies.robot_link import RobotLink, on_another_clock, runs_slower
from zarm_runtime import clock
from zarm_runtime.bus import Bus
from zarm_trajectory.arrays import Array
from zarm_trajectory.trajectory import TimedTrajectory

_LEAD = 0.05
"""How long (s) before its beginning a chunk is sent, so that all have it by then: part of the delay in `CommandTiming`."""
_DEADLINE = 0.5
"""Time (s) after which a robot that gets no chunk gives up the stream; it rests long before."""
_REPEATED = 0.1
"""Interval (s) of the chunks that keep a stream open while the robot rests."""
_KEPT = 1.0
"""How long (s) a stream stays open at rest: the next motion then begins at once."""


class _Member:
    """The robot `name` that is the group `group`; `columns` are its joints among those of the whole."""

    def __init__(self, bus: Bus, group: str, name: str, joints: tuple[str, ...]) -> None:
        keys = Keys(name)
        self.name, self.called = name, f"{group} (the robot {name})"
        self.joints = tuple(joint.removeprefix(f"{group}_") for joint in joints if joint.startswith(f"{group}_"))
        self.columns = [joints.index(f"{group}_{joint}") for joint in self.joints]
        self._states = bus.latest(keys.joint_states)
        self._chunks = bus.publisher(keys.stream)
        self._lock = threading.Lock()
        self._state: ExecutorState | None = None
        self._goal: GoalState | None = None
        self._other_clock = False
        bus.watch(keys.executor_state, self._on_state)
        bus.watch(keys.goal("*"), self._on_goal)

    def put(self, chunk: StreamChunk) -> None:
        """Send it the next part of its motion."""
        self._chunks.put(chunk)

    def measured(self) -> Measured | None:
        """Its newest joints, in the order of `columns`; None before the first."""
        received = self._states.received()
        if received is None or sorted(received[0].joint_names) != sorted(self.joints):
            return None
        state, at = received
        self._other_clock = on_another_clock(state.stamp, at)
        if self._other_clock:
            return None
        order = [state.joint_names.index(joint) for joint in self.joints]
        position, velocity = np.array((state.position, state.velocity))[:, order]
        effort = None if state.effort is None else np.array(state.effort)[order]
        return Measured(position, velocity, at, state.stamp, effort)

    def follows(self, goal_id: str | None) -> bool:
        """Whether it moves for this goal."""
        state = self._state
        return state is not None and state.goal_id is not None and state.goal_id == goal_id

    def trouble(self, goal_id: str | None, ended: str | None) -> str | None:
        """Why it does not follow the stream `goal_id`, or without one could not follow any once `ended` is over; None if it does, or could."""
        with self._lock:
            state, goal = self._state, self._goal
        if state is None:
            return f"no executor answers for {self.called}; start it with `zarm up --name {self.name}`"
        self.measured()
        if self._other_clock:
            return runs_slower(self.called)
        if state.mode == "fault":
            reason = "" if state.problem is None else f": {state.problem.message}"
            return f"{self.called} is in fault{reason}; reset it"
        if state.speed_scale < 1.0:
            return (
                f"{self.called} moves at {state.speed_scale:g} of its speed and would fall behind; set it to 1 with "
                f"`zarm speed 1 --name {self.name}`, and slow down the whole"
            )
        if goal_id is None:
            free = state.mode == "idle" or state.goal_id == ended
            return None if free else f"{self.called} moves for {state.goal_id}; let it come to rest"
        if goal is None or goal.goal_id != goal_id:
            return None  # it has not begun yet
        if goal.done:
            return f"{self.called} has ended its part: {goal.status if goal.problem is None else goal.problem.message}"
        if goal.status in ("paused", "stopping"):
            return f"{self.called} stops{'' if goal.problem is None else f': {goal.problem.message}'}"
        return None if goal.hold is None else f"{self.called} is held by its servo ({goal.hold.reason})"

    def _on_state(self, _key: str, state: ExecutorState) -> None:
        with self._lock:
            self._state = state

    def _on_goal(self, _key: str, goal: GoalState) -> None:
        with self._lock:
            if self._goal is None or goal.goal_id == self._goal.goal_id or not goal.done:
                self._goal = goal


class ExecutorsLink(RobotLink):
    """Leads the executors that `descriptor.executors` names, each by a stream of its joints. A stream spans all motions until the
    robot has been at rest for a while.
    """

    def __init__(self, bus: Bus, descriptor: RobotDescriptor, timing: CommandTiming) -> None:
        super().__init__(descriptor, timing)
        self._members = [
            _Member(bus, group, led.robot, descriptor.joints) for group, led in descriptor.executors.items()
        ]
        self._measured: Measured | None = None
        self._goal_id: str | None = None
        self._ended_id: str | None = None
        self._over_since: float | None = None
        self._sequence, self._began, self._sent = 0, 0.0, 0.0
        self._end = np.zeros(len(self.joints))

    # -- to the executors --

    def begin(self) -> None:
        """The stream goes on, or another one begins with the next chunk: after one that a robot has left."""
        self._over_since = None
        if self.trouble() is not None:
            self._ended_id, self._goal_id = self._goal_id, None

    def lead(self, points: TimedTrajectory, begin: float) -> None:
        """Let all follow these points from the moment `begin` (s, monotonic) on, in an open stream."""
        self._end = points.end
        self._put(points, begin)

    def end(self, now: float) -> None:
        """The motion is over at `now` (s, monotonic)."""
        self._over_since = now

    def opened(self, position: Array, now: float) -> bool:
        """Whether all robots follow the stream; it is opened, with the robots resting at `position` (J,), once none is still at the end of
        the last one.
        """
        if self._goal_id is not None:
            return all(member.follows(self._goal_id) for member in self._members)
        if not any(member.follows(self._ended_id) for member in self._members):
            self._goal_id, self._sequence, self._began = f"lead-{secrets.token_hex(6)}", 0, now
            self._end = position
            self._put(TimedTrajectory.standing(position, self.timing.point_dt), now - _LEAD)
        return False

    def keep(self, now: float) -> None:
        """At each tick at rest: keep the stream open, and end it some time after the motion, or when one of the robots has left it."""
        if self._goal_id is None or now - self._sent < _REPEATED:
            return
        over = self._over_since is not None and now - self._over_since > _KEPT
        self._rest(now, last=(over and self.standing()) or self.trouble() is not None)

    def release(self) -> None:
        """End the stream; the robots are at rest."""
        if self._goal_id is not None:
            self._rest(clock.monotonic(), last=True)

    def stop(self) -> int:
        """Nothing to send: what the robots have ends with braking along the path."""
        return self._sequence

    def _rest(self, now: float, *, last: bool) -> None:
        """Let all rest where the last chunk ends; with `last`, end the stream."""
        self._put(TimedTrajectory.standing(self._end, self.timing.point_dt), now, last=last)
        if last:
            self._ended_id, self._goal_id = self._goal_id, None

    def _put(self, points: TimedTrajectory, begin: float, *, last: bool = False) -> None:
        if self._goal_id is None:
            return
        self._sequence, self._sent = self._sequence + 1, begin
        times, states = points.time, points.states
        if not last:  # the time of a stream runs on only before the end of its trajectory
            rest = np.zeros_like(states[:, -1:])
            rest[0] = states[0, -1:]
            times, states = np.append(times, times[-1] + _DEADLINE), np.concatenate((states, rest), axis=1)
        for member in self._members:
            member.put(
                StreamChunk(
                    goal_id=self._goal_id,
                    sequence=self._sequence,
                    start=max(begin + _LEAD - self._began, 0.0),
                    trajectory=TimedTrajectory(times, *states[:, :, member.columns]).message(member.joints),
                    deadline=_DEADLINE,
                    last=last,
                    begin_at=None if self._sequence > 1 else clock.unix_time_of(self._began),
                )
            )

    # -- from the executors --

    def measured(self) -> Measured | None:
        """The joints of all, as old as the oldest; None before the first of each."""
        parts = [measured for member in self._members if (measured := member.measured()) is not None]
        if len(parts) < len(self._members):
            return self._measured
        at = min(part.time for part in parts)
        if self._measured is None or at > self._measured.time:
            stamps = [part.stamp for part in parts if part.stamp is not None]
            efforts = [part.effort for part in parts if part.effort is not None]
            self._measured = Measured(
                self._whole([part.position for part in parts]),
                self._whole([part.velocity for part in parts]),
                at,
                min(stamps) if len(stamps) == len(parts) else None,
                self._whole(efforts) if len(efforts) == len(parts) else None,
            )
            self._note(self._measured)
        return self._measured

    def _whole(self, parts: Sequence[Array]) -> Array:
        """The values (J,) of all joints from those of each robot."""
        values = np.empty(len(self.joints))
        for member, part in zip(self._members, parts, strict=True):
            values[member.columns] = part
        return values

    def trouble(self) -> str | None:
        """Why one of the robots does not follow; None if all do."""
        return None if self._goal_id is None else next(self._troubles(self._goal_id), None)

    def pace(self) -> float:
        """The robots' own executors move them at their full speed."""
        return 1.0

    def obstacle(self) -> str | None:
        """One of the robots that cannot follow."""
        return next(self._troubles(None), None)

    def _troubles(self, goal_id: str | None) -> Iterator[str]:
        for member in self._members:
            if (trouble := member.trouble(goal_id, self._goal_id or self._ended_id)) is not None:
                yield trouble
