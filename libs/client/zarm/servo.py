"""The servo of a robot: live targets that the robot follows."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from typing import TYPE_CHECKING, Literal, TypeVar, overload

from zarm.calls import Calls
from zarm.connection import Connection
from zarm.values import made
from zarm_contract.errors import ZarmError
from zarm_contract.messages import ServoStart

if TYPE_CHECKING:
    from zarm.servoing import ChunkTracking, Jogging, Tracking

S = TypeVar("S", "ChunkTracking", "Jogging", "Tracking")


class Servo(Calls):
    """Sessions in which a program steers the robot; leaving one brings the robot to rest."""

    @overload
    def track(
        self,
        *,
        chunks: Literal[False] = False,
        margin: float = 0.01,
        velocity_scale: float = 1.0,
        acceleration_scale: float = 1.0,
        take_over: bool = False,
    ) -> AbstractContextManager[Tracking]: ...

    @overload
    def track(
        self,
        *,
        chunks: Literal[True],
        margin: float = 0.01,
        velocity_scale: float = 1.0,
        acceleration_scale: float = 1.0,
        take_over: bool = False,
    ) -> AbstractContextManager[ChunkTracking]: ...

    def track(
        self,
        *,
        chunks: bool = False,
        margin: float = 0.01,
        velocity_scale: float = 1.0,
        acceleration_scale: float = 1.0,
        take_over: bool = False,
    ) -> AbstractContextManager[Tracking] | AbstractContextManager[ChunkTracking]:
        """The robot follows a changing pose or changing joint positions, and avoids collisions.

        ```python
        with robot.track() as tracking:
            while looking:
                tracking.to(seen_pose())
        ```

        With `chunks` it follows what a policy plans ahead, many points at a time:

        ```python
        with robot.track(chunks=True) as tracking:
            while running:
                tracking.follow(policy(observation()), dt=1 / 30)
        ```

        `margin` (m) is kept to the scene and between the robot's own links; the scales are shares of the limits of velocity and
        acceleration. Raises Busy if another session is open, unless `take_over` is set. Leaving the block brings the robot to
        rest. Raises Unavailable without a servo, or if the servo does not know the scene.
        """
        from zarm.servoing import ChunkTracking, Tracking

        options = margin, velocity_scale, acceleration_scale, take_over
        return self._session(ChunkTracking, *options) if chunks else self._session(Tracking, *options)

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
