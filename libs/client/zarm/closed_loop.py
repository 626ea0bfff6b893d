"""Closed-loop motion of a robot: streams of trajectories, and live targets that the servo follows."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, TypeVar

from zarm.connection import Connection
from zarm.motion import Motion
from zarm.values import made
from zarm_contract.errors import ZarmError, from_problem
from zarm_contract.messages import ServoStart

if TYPE_CHECKING:
    from zarm.servoing import Jogging, Tracking
    from zarm.streaming import Stream

S = TypeVar("S", "Jogging", "Tracking")


class ClosedLoop(Motion):
    """Blocks in which a program steers the robot; leaving one stops the robot."""

    @contextmanager
    def stream(self, *, deadline: float = 0.2) -> Iterator[Stream]:
        """A stream of short trajectories for closed-loop control, each replacing the rest of the one before.

        ```python
        with robot.stream() as stream:
            while stream.running and not done:
                stream.send(trajectory_from(stream.time))
        ```

        The next one must be sent within `deadline` s (at most 1); otherwise the robot brakes and DeadlineExceeded is raised.
        Leaving the block waits until the robot rests: at the end of a trajectory sent as the `last`, or by braking at once.
        """
        from zarm.streaming import Stream

        stream = Stream(self.connection, deadline)
        try:
            yield stream
        except BaseException:
            self._rest(stream.goal_id)
            raise
        if stream.open:
            self._rest(stream.goal_id)
        elif (end := stream.end()) is not None and end.problem is not None:
            raise from_problem(end.problem)

    @contextmanager
    def track(
        self,
        *,
        margin: float = 0.01,
        velocity_scale: float = 1.0,
        acceleration_scale: float = 1.0,
        take_over: bool = False,
    ) -> Iterator[Tracking]:
        """The robot follows a changing pose or changing joint positions, and avoids collisions.

        ```python
        with robot.track() as tracking:
            while looking:
                tracking.to(seen_pose())
        ```

        `margin` (m) is kept to the scene and between the robot's own links; the scales are shares of the limits of velocity and
        acceleration. Raises Busy if another session is open, unless `take_over` is set. Leaving the block brings the robot to
        rest. Raises Unavailable without a servo, or if the servo does not know the scene.
        """
        from zarm.servoing import Tracking

        with self._session(Tracking, margin, velocity_scale, acceleration_scale, take_over) as tracking:
            yield tracking

    @contextmanager
    def jog(
        self,
        *,
        margin: float = 0.01,
        velocity_scale: float = 1.0,
        acceleration_scale: float = 1.0,
        take_over: bool = False,
    ) -> Iterator[Jogging]:
        """The robot moves by a twist of its tip or by joint speeds, as long as they keep coming: see `track`.

        ```python
        with robot.jog() as jogging:
            while pressed():
                jogging.twist(linear=(0, 0, 0.05))
        ```
        """
        from zarm.servoing import Jogging

        with self._session(Jogging, margin, velocity_scale, acceleration_scale, take_over) as jogging:
            yield jogging

    @contextmanager
    def _session(
        self,
        kind: Callable[[Connection, ServoStart], S],
        margin: float,
        velocity_scale: float,
        acceleration_scale: float,
        take_over: bool,
    ) -> Iterator[S]:
        request = made(
            ServoStart,
            margin=margin,
            velocity_scale=velocity_scale,
            acceleration_scale=acceleration_scale,
            take_over=take_over,
        )
        session = kind(self.connection, request)
        try:
            yield session
        except BaseException:
            with self._until_left(), suppress(ZarmError):
                session.end()
            raise
        session.end()
