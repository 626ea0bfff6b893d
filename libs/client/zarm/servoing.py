"""Sessions of the servo: the robot follows a live target and avoids obstacles on its way."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Literal, cast

from pydantic import ValidationError

from zarm.connection import Connection
from zarm.values import invalid, numbers, rows
from zarm_contract.errors import DeadlineExceeded, InvalidRequest, Unavailable, from_problem
from zarm_contract.messages import (
    ChunkAccepted,
    GoalState,
    JointPoints,
    JointSpeedTarget,
    JointTarget,
    Pose,
    PoseGoal,
    PosePoints,
    PoseTarget,
    ServoChunk,
    ServoEnd,
    ServoSession,
    ServoStart,
    ServoState,
    ServoTarget,
    TwistTarget,
    Vector3,
)
from zarm_runtime import clock

if TYPE_CHECKING:
    from zarm.values import Numbers, Rows

PERIOD = 0.02
"""Interval (s) at which this client repeats a target."""
POSITION_TOLERANCE, ANGLE_TOLERANCE, JOINT_TOLERANCE = 0.001, 0.01, 0.002
"""m, rad, rad: a robot this close to its target has reached it."""
_START_SECONDS, _END_SECONDS = 10.0, 8.0
_CHUNK_SECONDS = 2.0
"""Longest time for the answer to a chunk."""


class _Session:
    """One session, which is the executor's goal `goal_id`. Raises the servo's refusal."""

    def __init__(self, connection: Connection, request: ServoStart) -> None:
        self._connection = connection
        self._sequence = 0
        self._state: ServoSession | None = None
        self._publisher = connection.publisher(connection.keys.servo_target)
        connection.interrupts.run_interruptibly(connection.goals.listen)
        started = connection.ask(connection.keys.servo_start, request, timeout=_START_SECONDS)
        self.goal_id = started.goal_id
        self._unwatch = connection.interrupts.run_interruptibly(
            lambda: connection.bus.watch(connection.keys.servo_state, self._on_state)
        )

    @property
    def state(self) -> ServoSession | None:
        """The session's last state: what limits it, the clearance, the error. None before the first one."""
        return self._state

    @property
    def running(self) -> bool:
        """Whether the session has not ended yet."""
        goal = self._goal
        return goal is None or not goal.done

    def end(self) -> None:
        """Bring the robot to rest and wait for it. Raises the problem with which the goal ended."""
        try:
            if self.running:
                request = ServoEnd(goal_id=self.goal_id)
                self._connection.ask(self._connection.keys.servo_end, request, timeout=_END_SECONDS)
        finally:
            self._unwatch()
        self._raise()

    def _send(self, make: Callable[[], PoseTarget | TwistTarget | JointSpeedTarget | JointTarget]) -> None:
        self._demand_running()
        self._sequence += 1
        try:
            target = ServoTarget(goal_id=self.goal_id, sequence=self._sequence, stamp=clock.monotonic(), target=make())
        except ValidationError as error:
            raise invalid("the target", error) from None
        self._publisher.put(target)

    def _demand_running(self) -> None:
        self._raise()
        if not self.running:
            raise Unavailable("the session has ended; start another one, and use it inside its `with`")

    @property
    def _goal(self) -> GoalState | None:
        return self._connection.goals.known(self.goal_id)

    def _raise(self) -> None:
        goal = self._goal
        if goal is not None and goal.problem is not None:
            raise from_problem(goal.problem)

    def _on_state(self, _: str, state: ServoState) -> None:
        if state.session is not None and state.session.goal_id == self.goal_id:
            self._state = state.session


class Tracking(_Session):
    """The robot follows a pose of its tip, or joint positions; `Robot.track` makes it."""

    def to(
        self,
        goal: Pose | PoseGoal | Numbers,
        *,
        linear: Numbers | None = None,
        angular: Numbers | None = None,
        group: str | None = None,
    ) -> None:
        """Set the target: a `zarm.Pose` of the tip in the base frame, a `zarm.PoseGoal` with freedom, or joint positions (rad). Of a
        robot with several arms, poses are those of the tip of a `group`.

        Call it repeatedly, at least 20 times a second: the robot brakes if the target is older than 0.1 s. `linear`
        (m/s) and `angular` (rad/s) are the velocity of a pose in the base frame, by default estimated from successive
        poses. Raises the problem with which the session has ended, and Unavailable if it has ended without one.
        """
        if isinstance(goal, PoseGoal) and (goal.alternatives or goal.tip or goal.approach or goal.retreat):
            raise InvalidRequest("a live target is one pose of the tip, with a tolerance at most", field="goal")
        if isinstance(goal, Pose | PoseGoal):
            self._send(
                lambda: PoseTarget(
                    kind="pose",
                    frame="base",
                    position=goal.position,
                    orientation=goal.orientation,
                    linear=_vector(linear, "linear"),
                    angular=_vector(angular, "angular"),
                    tolerance=goal.tolerance if isinstance(goal, PoseGoal) else None,
                    group=group,
                )
            )
        else:
            self._send(lambda: JointTarget(kind="joints", position=numbers(goal, "goal")))

    def reach(
        self,
        goal: Pose | PoseGoal | Numbers,
        *,
        timeout: float,
        group: str | None = None,
        on_progress: Callable[[ServoSession], object] | None = None,
    ) -> None:
        """Move the robot to a fixed pose or fixed joint positions, as in `to`, and wait until it rests there, within 1 mm and 0.01
        rad.

        `on_progress` receives the session's states. Raises DeadlineExceeded, which names the obstacle, if the target is
        not reached within `timeout` s.
        """
        deadline, before = clock.monotonic() + timeout, self._state
        first = self._sequence + 1
        while clock.monotonic() < deadline:
            self.to(goal, group=group)
            self._connection.interrupts.run_interruptibly(lambda: clock.sleep(PERIOD))
            state = self._state
            if state is None or state is before or state.sequence < first:
                continue
            before = state
            if on_progress is not None:
                on_progress(state)
            if not state.moving and _near(state):
                return
        raise DeadlineExceeded(f"the robot has not reached the target after {timeout:g} s: {limited(self._state)}")


class ChunkTracking(_Session):
    """The robot follows chunks of motion, each of many points; `Robot.track` makes it."""

    def follow(
        self,
        points: Rows | Sequence[Pose],
        *,
        dt: float | None = None,
        times: Numbers | None = None,
        start: float | None = None,
        velocities: Rows | None = None,
        opening: Numbers | None = None,
        gripper: str | None = None,
        observed: float | None = None,
        expiry: float | None = None,
        group: str | None = None,
    ) -> ChunkAccepted:
        """Follow 2 to 200 `points`: joint positions (rad), or a `zarm.Pose` each of the tip, of a `group` where there are several arms. They are
        `dt` (s) apart, or at `times` (s) from the first.

        The first is meant for the Unix time `start` (default: now). The robot follows the chunk before until then, and goes over to this one
        inside its limits. It brakes at the end of the chunk, or `expiry` (s) after its start: send the next before that. `velocities` (rad/s) are
        those of the joints at the points. `opening` (m) is that of the `gripper` at each point, and `observed` the Unix time of the observation.

        Returns what the servo says: how late the chunk came, what the limits clip, and what limits the robot now. Raises InvalidRequest for a
        chunk that is refused: the robot brakes when the one before has ended. Raises as `Tracking.to` does.
        """
        self._demand_running()
        stamp = clock.unix_time()
        self._sequence += 1
        try:
            of: JointPoints | PosePoints
            poses = tuple(point for point in points if isinstance(point, Pose))
            if poses:
                of = PosePoints(kind="poses", pose=poses, group=group)
            else:
                of = JointPoints(
                    kind="joints",
                    position=rows(cast("Rows", points), "points"),
                    velocity=None if velocities is None else rows(velocities, "velocities"),
                )
            chunk = ServoChunk(
                goal_id=self.goal_id,
                sequence=self._sequence,
                stamp=stamp,
                start=start,
                observed=observed,
                expiry=expiry,
                dt=dt,
                time=None if times is None else numbers(times, "times"),
                points=of,
                gripper=gripper,
                opening=None if opening is None else numbers(opening, "opening"),
            )
        except ValidationError as error:
            raise invalid("the chunk", error) from None
        return self._connection.ask(self._connection.keys.servo_chunk, chunk, timeout=_CHUNK_SECONDS)


class Jogging(_Session):
    """The robot moves at commanded velocities as long as they keep coming; `Robot.jog` makes it."""

    def twist(
        self,
        linear: Numbers = (0.0, 0.0, 0.0),
        angular: Numbers = (0.0, 0.0, 0.0),
        *,
        frame: Literal["base", "tool"] = "base",
        group: str | None = None,
    ) -> None:
        """Move the tip, or that of a `group`, at these velocities (m/s, rad/s) along the axes of the base or of the tool, for the next
        0.1 s at most.

        Raises the problem with which the session has ended, and Unavailable if it has ended without one.
        """
        self._send(
            lambda: TwistTarget(
                kind="twist",
                frame=frame,
                linear=_vector(linear, "linear") or (0.0, 0.0, 0.0),
                angular=_vector(angular, "angular") or (0.0, 0.0, 0.0),
                group=group,
            )
        )

    def joint_speed(self, velocity: Numbers) -> None:
        """Move the joints at these velocities (rad/s) for the next 0.1 s at most. Raises as `twist` does."""
        self._send(lambda: JointSpeedTarget(kind="joint_speed", velocity=numbers(velocity, "velocity")))


def limited(state: ServoSession | None) -> str:
    """What limits a session, in a few words."""
    if state is None:
        return "the servo has not told anything"
    pair = "" if state.link is None else f" by {state.object}, {1e3 * (state.distance or 0.0):.0f} mm from {state.link}"
    why = "" if state.unreachable is None else f"; the planner says: {state.unreachable.message}"
    return state.limiting.replace("_", " ") + pair + why


def _near(state: ServoSession) -> bool:
    if state.joint_error is not None:
        return state.joint_error < JOINT_TOLERANCE
    if state.position_error is None or state.orientation_error is None:
        return False
    return state.position_error < POSITION_TOLERANCE and state.orientation_error < ANGLE_TOLERANCE


def _vector(values: Numbers | None, field: str) -> Vector3 | None:
    if values is None:
        return None
    found = numbers(values, field)
    if len(found) != 3:
        raise InvalidRequest(f"three numbers are needed, not {len(found)}", field=field)
    return found[0], found[1], found[2]
