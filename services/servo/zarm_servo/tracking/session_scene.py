"""The scene in which a session checks its steps, loaded outside the cycles because large scenes take long."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from zarm_contract.errors import ZarmError
from zarm_contract.messages import SceneRevision
from zarm_geometry.motion_check import MotionCheck
from zarm_geometry.situation import MovingObject, NearPair
from zarm_runtime.worker import Worker
from zarm_servo.kernels.step import RANGE
from zarm_servo.tracking.controller import Surroundings
from zarm_servo.world.check import SceneCheck
from zarm_servo.world.moving_objects import MovingObjects
from zarm_servo.world.scene_monitor import SceneMonitor
from zarm_trajectory.arrays import Array

log = logging.getLogger(__name__)

_LINE = 0.05
"""Interval (rad) at which a straight line is checked."""


class SessionScene:
    """What `monitor` and `moving` knew at the last `look`, once `check` has loaded it. Calls `failed()` if loading
    fails.

    The constructor loads the static objects, which raises Unavailable if a mesh cannot be read. From `open` to `close`
    a thread keeps them up to date.
    """

    def __init__(
        self, check: SceneCheck, monitor: SceneMonitor, moving: MovingObjects, now: float, failed: Callable[[], None]
    ) -> None:
        self._check, self._monitor, self._moving, self._failed = check, monitor, moving, failed
        self._around = Surroundings()
        self._scene = monitor.snapshot(now)
        self._seen = self._scene, moving.of(self._scene)
        self._load()
        self._news = threading.Event()
        self._worker = Worker("scene", self._run)

    @property
    def motions(self) -> MotionCheck:
        """The motion check in this scene."""
        return self._check.motions

    @property
    def revision(self) -> SceneRevision | None:
        """The loaded revision."""
        return self._scene.revision

    def open(self) -> None:
        """Begin to keep the scene up to date."""
        self._worker.start()

    def close(self) -> None:
        """Stop: the check is free for another session."""
        self._worker.stop()

    def look(self, now: float) -> None:
        """Take what is known at `now` (s, monotonic): moving objects at once, static ones when loaded."""
        movers, scene = self._seen[1], self._monitor.snapshot(now)
        self._seen = scene, self._moving.of(scene)
        if scene is not self._scene or len(movers) != len(self._seen[1]):
            self._news.set()
            self._worker.wake()

    def around(self, now: float, ahead: float, scale: float) -> Surroundings:
        """The surroundings for a motion that begins `ahead` s after `now` (s, monotonic) and runs at `scale` times its
        speed.
        """
        return replace(self._around, moving=self._moved(now, ahead, scale))

    def nearby(self, position: Array, now: float, scale: float) -> list[NearPair]:
        """What is near the robot at `position` (J,) at `now` (s, monotonic), nearest first."""
        around = self._around
        return self.motions.nearby(
            position,
            within=RANGE,
            attached=around.attached,
            ignored_links=around.ignored_links,
            moving=self._moved(now, 0.0, scale),
            openings=around.openings,
            allowed=around.allowed,
        )

    def is_free(self, start: Array, end: Array, margin: float) -> bool:
        """Whether the straight line between two positions (J,) keeps the margin (m) to static objects."""
        count = 2 + int(np.abs(end - start).max() / _LINE)
        return self.motions.check(
            np.arange(float(count)),
            np.linspace(start, end, count),
            margin=margin,
            attached=self._around.attached,
            ignored_links=self._around.ignored_links,
            openings=self._around.openings,
            allowed=self._around.allowed,
            acceleration=np.zeros(len(start)),
        ).free

    def catch_up(self) -> None:
        """Load the scene seen last if it has changed. Raises Unavailable if a mesh cannot be read."""
        if self._news.is_set():
            self._news.clear()
            self._load()

    def _run(self) -> None:
        try:
            self.catch_up()
        except ZarmError:
            log.exception("the session's scene failed; the session ends")
            self._failed()

    def _moved(self, now: float, ahead: float, scale: float) -> list[MovingObject]:
        return [mover.moving(now, ahead, scale) for mover in self._seen[1]]

    def _load(self) -> None:
        scene, movers = self._seen
        around = Surroundings(scene.attached, scene.ignored_links, openings=scene.openings, allowed=scene.ignored_pairs)
        if len(around.attached) > len(self._around.attached):
            self._around = (
                around  # an object just attached or detached may be present twice for a moment, but is never missing
            )
        self._check.load(scene.objects, [mover.item.name for mover in movers])
        self._scene, self._around = scene, around
