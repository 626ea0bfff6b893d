"""The strategy that moves a robot of several robots through their own executors, each of which follows its part as a stream."""

from __future__ import annotations

from zarm_contract.errors import Unavailable
from zarm_contract.strategies import EXECUTORS
from zarm_executor.strategies.executors_link import ExecutorsLink
from zarm_executor.strategies.streaming import Streaming
from zarm_runtime import clock
from zarm_trajectory.retimed import RetimedTrajectory


class Executors(Streaming):
    """Sends chunks with velocities and accelerations. All parts come from one motion along one path, so they stay in step whatever its speed, and brake
    together. If one of the executors stops by itself, the motion ends.
    """

    name = EXECUTORS

    def __init__(self, link: ExecutorsLink) -> None:
        super().__init__(link)
        self._executors = link

    def admit(self) -> None:
        """Only if all can follow."""
        if (reason := self.obstacle()) is not None:
            raise Unavailable(reason)

    def problem(self) -> str | None:
        """Why one of them does not follow. One that is silent holds the motion first, as a silent driver does."""
        return None if self._over or not self.link.is_reporting(clock.monotonic()) else self._executors.trouble()

    def tick(self, now: float, dt: float) -> None:
        """Advance; at rest, keep the stream open."""
        super().tick(now, dt)
        if self._over or self._sent_at is None:
            self._executors.keep(now)

    def end(self) -> None:
        """After a while, leave the executors to others."""
        self._executors.end(clock.monotonic())

    def close(self) -> None:
        """The robot is at rest: the executors are free."""
        self._executors.release()

    def _begin(self, now: float) -> float | None:
        """The first chunk of a motion not before all executors follow the stream; one that brakes, to those that still do."""
        if self._sent_at is None and not self._executors.opened(self.progress().command, now):
            return None
        return super()._begin(now)

    def _send(self, ahead: RetimedTrajectory, now: float, played: int) -> bool:
        self._executors.lead(ahead.points, now if self._sent_at is None else self._sent_at + played * self._dt)
        return bool((ahead.points.position == ahead.points.position[0]).all())
