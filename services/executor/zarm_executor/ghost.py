"""The ghost: plays every plan once as a preview, whatever the strategy. It moves nothing, and its failure affects
nothing else.
"""

from __future__ import annotations

import logging
import threading

from zarm_contract.errors import ZarmError
from zarm_contract.keys import Keys
from zarm_contract.messages import JointState, Plan
from zarm_contract.robot import RobotDescription
from zarm_executor.checks import executable
from zarm_runtime import clock
from zarm_runtime.bus import Bus
from zarm_trajectory.trajectory import TimedTrajectory

log = logging.getLogger(__name__)

PERIOD, REST_PERIOD = 0.02, 0.1
"""Periods of `preview/joint_states`, s: while a plan is played, and when it has ended."""
MIN_SHOWN_TIME = 0.2
"""Shortest time (s) for which a plan is shown: if plans come faster than anyone can see, only the newest is."""


class Ghost:
    """Shows the newest plan on `preview/trajectory` and plays it on `preview/joint_states`, where it stays at its end."""

    def __init__(self, bus: Bus, keys: Keys, robot: RobotDescription) -> None:
        self._robot = robot
        self._joints = robot.descriptor.joints
        self._trajectories = bus.publisher(keys.preview_trajectory)
        self._joint_states = bus.publisher(keys.preview_joint_states)
        self._newest: Plan | None = None
        self._trajectory: TimedTrajectory | None = None
        self._began = self._shown = 0.0
        self._lock = threading.Lock()
        self._news = threading.Event()

    def show(self, _key: str, plan: Plan) -> None:
        """Play this plan from the next period on; may be called from any thread."""
        with self._lock:
            self._newest = plan
        self._news.set()

    def play(self, now: float) -> None:
        """One period; `now` is on the monotonic clock. An error ends only the preview of this plan.

        If nothing is playing, waits up to `REST_PERIOD` for a plan.
        """
        try:
            self._play(now)
        except Exception:  # a mere display must not end a process that moves a robot
            log.exception("the preview failed; it goes on with the next plan")
            self._trajectory = None

    def _play(self, now: float) -> None:
        plan = self._next() if now - self._began > MIN_SHOWN_TIME else None
        if plan is not None:
            self._begin(plan, now)
        trajectory = self._trajectory
        rests = trajectory is None or self._shown - self._began > trajectory.duration
        if trajectory is not None and (not rests or now - self._shown > 0.9 * REST_PERIOD):
            self._shown = now
            position, velocity, _ = trajectory.at(now - self._began)
            self._joint_states.put(
                JointState(
                    stamp=clock.unix_time(),
                    joint_names=self._joints,
                    position=tuple(position.tolist()),
                    velocity=tuple(velocity.tolist()),
                )
            )
        if rests and self._news.wait(clock.real_seconds(REST_PERIOD)):
            self._news.clear()

    def _next(self) -> Plan | None:
        with self._lock:
            plan, self._newest = self._newest, None
            return plan

    def _begin(self, plan: Plan, now: float) -> None:
        try:
            self._trajectory = executable(plan.trajectory, self._robot)
        except ZarmError as error:
            log.warning("a plan cannot be previewed plan_id=%s reason=%s", plan.plan_id, error)
            return
        self._began = now
        self._trajectories.put(plan.trajectory)
