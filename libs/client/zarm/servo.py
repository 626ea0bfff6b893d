"""The servo of a robot: live targets that the robot follows."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from typing import TYPE_CHECKING, Literal, Protocol, TypedDict, TypeVar, Unpack, overload

from zarm.calls import Calls
from zarm.connection import ANSWER_SECONDS, Connection
from zarm.values import made
from zarm_contract.errors import ZarmError
from zarm_contract.messages import JointDynamics, Nothing, ServoStart

if TYPE_CHECKING:
    from zarm.servoing import ChunkTracking, Jogging, Tracking

S = TypeVar("S", "ChunkTracking", "Jogging", "Tracking")


class SessionOptions(TypedDict, total=False):
    """How a session leads the robot: at least `margin` (m, default 0.01) away from the scene and with its own links apart; with these shares of the
    limits of velocity and acceleration (default 1); with `take_over`, another session is brought to rest first.
    """

    margin: float
    velocity_scale: float
    acceleration_scale: float
    take_over: bool


class Track(Protocol):
    """The types of `Servo.track`."""

    @overload
    def __call__(
        self, *, chunks: Literal[False] = False, **options: Unpack[SessionOptions]
    ) -> AbstractContextManager[Tracking]: ...

    @overload
    def __call__(
        self, *, chunks: Literal[True], **options: Unpack[SessionOptions]
    ) -> AbstractContextManager[ChunkTracking]: ...


class Servo(Calls):
    """Sessions in which a program steers the robot; leaving one brings the robot to rest."""

    @overload
    def track(
        self, *, chunks: Literal[False] = False, **options: Unpack[SessionOptions]
    ) -> AbstractContextManager[Tracking]: ...

    @overload
    def track(
        self, *, chunks: Literal[True], **options: Unpack[SessionOptions]
    ) -> AbstractContextManager[ChunkTracking]: ...

    def track(
        self, *, chunks: bool = False, **options: Unpack[SessionOptions]
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

        Options: `margin` (m, default 0.01) is kept to the scene and between the robot's own links; `velocity_scale` and `acceleration_scale` are shares
        of the limits. Raises Busy if another session is open, unless `take_over` is set. Leaving the block brings the robot to
        rest. Raises Unavailable without a servo, or if the servo does not know the scene.
        """
        from zarm.servoing import ChunkTracking, Tracking

        return self._session(ChunkTracking, options) if chunks else self._session(Tracking, options)

    @contextmanager
    def jog(self, **options: Unpack[SessionOptions]) -> Iterator[Jogging]:
        """The robot moves by a twist of its tip or by joint speeds, as long as they keep coming. Options as of `track`.

        ```python
        with robot.jog() as jogging:
            while pressed():
                jogging.twist(linear=(0, 0, 0.05))
        ```
        """
        from zarm.servoing import Jogging

        with self._session(Jogging, options) as jogging:
            yield jogging

    def joint_dynamics(self, *, timeout: float = ANSWER_SECONDS) -> JointDynamics:
        """The friction of the joints and the inertia of their motors, identified from the efforts in the motions since the servo began. Raises Unavailable
        without efforts, without the inertia of each link in the URDF, or before there has been enough motion.
        """
        return self._ask(self._keys.joint_dynamics, Nothing(), timeout=timeout)

    @contextmanager
    def _session(self, kind: Callable[[Connection, ServoStart], S], options: SessionOptions) -> Iterator[S]:
        session = kind(self.connection, made(ServoStart, **options))
        try:
            yield session
        except BaseException:
            with self._until_left(), suppress(ZarmError):
                session.end()
            raise
        session.end()
