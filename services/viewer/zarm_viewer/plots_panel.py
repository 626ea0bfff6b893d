"""Plots against the limits: of the last plan, and of the last seconds."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Sequence

import numpy as np
from viser import GuiUplotHandle, uplot

from zarm.robot import Robot
from zarm_contract.errors import ZarmError
from zarm_contract.messages import Plan
from zarm_trajectory.arrays import Array
from zarm_trajectory.trajectory import TimedTrajectory
from zarm_viewer.kinematics import Chain
from zarm_viewer.panel_context import PanelContext
from zarm_viewer.watching import News

QUANTITIES = ("position", "velocity", "acceleration", "jerk")
SECONDS, RATE = 10.0, 10.0
"""Length (s) of the live plots, and their sample rate (Hz)."""
LIVE = (*QUANTITIES, "tracking error (mrad)")
TORQUE = "torque"
TOOL_SPEED = "tool speed (m/s)"
TICKS = "tick lateness (ms)"
TOOL_SAMPLES = TORQUE_SAMPLES = 300
_COLOURS = ("#e03131", "#2f9e44", "#1971c2", "#f08c00", "#9c36b5", "#0c8599", "#495057")


class Measured:
    """Measured velocities, and accelerations and jerks derived as differences over at least 1 / `RATE` s, (J,) in
    rad/s^n.
    """

    def __init__(self, joints: int) -> None:
        self._velocity = self._before = self._acceleration = self._jerk = np.zeros(joints)
        self._at: float | None = None

    def add(self, velocity: Array, at: float) -> None:
        """Add a measurement at a time (s); a time before the last one means another record, or a restart of the same."""
        self._velocity = velocity
        if self._at is None or at < self._at:
            self._before, self._at = velocity, at
        elif (passed := at - self._at) >= 1 / RATE:
            acceleration = (velocity - self._before) / passed
            self._jerk, self._acceleration = (acceleration - self._acceleration) / passed, acceleration
            self._before, self._at = velocity, at

    def rates(self) -> tuple[Array, Array, Array]:
        """Velocity, acceleration and jerk."""
        return self._velocity, self._acceleration, self._jerk


class PlotsPanel:
    """Each joint as a share of its limit: 100 % is the limit, or for positions the upper one and -100 % the lower."""

    def __init__(self, panels: PanelContext) -> None:
        self._panels = panels
        cspace = panels.description.descriptor.cspace
        lower, upper = map(np.array, panels.description.range_about(panels.description.descriptor.home))
        self._middle, half = (upper + lower) / 2, (upper - lower) / 2
        self._limits = (half, np.array(cspace.velocity), np.array(cspace.acceleration), np.array(cspace.jerk))
        self._plan: Plan | None = None
        self._past: deque[tuple[float, Array]] = deque(maxlen=int(SECONDS * RATE))
        self._error = np.zeros(len(lower))
        self._ticks: deque[tuple[float, float]] = deque(maxlen=int(SECONDS * RATE))
        self._measured = Measured(len(lower))
        gui = panels.server.gui
        of_plan = (*QUANTITIES, TORQUE, TOOL_SPEED) if panels.client is not None else (*QUANTITIES, TOOL_SPEED)
        self._choice = gui.add_dropdown("of the plan", of_plan, initial_value="velocity")
        self._choice.on_update(lambda _: self._draw_plan())
        joint_names = panels.description.descriptor.joints
        self._of_plan = self._plot("share of the limit (%)", joint_names)
        self._of_tool = self._plot(TOOL_SPEED, ("tip",))
        self._of_tool.visible = False
        self._unknown = gui.add_markdown("", visible=False)
        self._live = gui.add_dropdown("live", ("off", *LIVE, TICKS), initial_value="off")
        self._of_now = self._plot("live", joint_names)
        self._of_ticks = self._plot(TICKS, ("latest tick of the control loop",))
        self._of_now.visible = self._of_ticks.visible = False

    def draw(self, news: News) -> None:
        """Show what has changed."""
        if news.plan is not None:
            self._plan = news.plan
            self._draw_plan()
        if news.velocity is not None and news.measured_at is not None:
            self._measured.add(news.velocity, news.measured_at)
        now = time.monotonic()
        for goal in news.goals:
            if goal.done:
                self._error = np.zeros(len(self._error))
            elif news.tracking_error is not None:
                self._error = 1e3 * news.tracking_error
            if goal.tick_lateness is not None:
                self._ticks.append((now, 1e3 * goal.tick_lateness))
        if self._past and now - self._past[-1][0] < 1 / RATE:
            return
        shares = 100 * np.array([self._panels.joints - self._middle, *self._measured.rates()]) / self._limits
        self._past.append((now, np.array([*shares, self._error])))
        shown = self._live.value
        for plot, visible in ((self._of_now, shown in LIVE), (self._of_ticks, shown == TICKS)):
            if plot.visible != visible:
                plot.visible = visible
        if shown in LIVE and len(self._past) > 1:
            row = LIVE.index(shown)
            times = np.array([at for at, _ in self._past]) - now
            self._of_now.data = (times, *np.array([rows[row] for _, rows in self._past]).T)
        if shown == TICKS and len(self._ticks) > 1:
            times, late = np.array(self._ticks).T
            recent = times > now - SECONDS
            self._of_ticks.data = (times[recent] - now, late[recent])

    def _plot(self, title: str, labels: Sequence[str]) -> GuiUplotHandle:
        series = (
            uplot.Series(label="s"),
            *(
                uplot.Series(label=label, stroke=_COLOURS[index % len(_COLOURS)], width=2)
                for index, label in enumerate(labels)
            ),
        )
        nothing = tuple(np.zeros(2) for _ in labels)
        return self._panels.server.gui.add_uplot(
            (np.array([0.0, 1.0]), *nothing), series, title=title, scales={"x": {"time": False}}, height=220
        )

    def _draw_plan(self) -> None:
        if self._plan is None:
            return
        timed = TimedTrajectory.of(self._plan.trajectory, self._panels.description.descriptor.joints)
        of_tool = self._choice.value == TOOL_SPEED
        self._of_plan.visible, self._of_tool.visible = not of_tool, of_tool
        self._unknown.visible = False
        if self._choice.value == TORQUE:
            threading.Thread(target=self._draw_torque, args=(self._plan, timed), name="torque", daemon=True).start()
            return
        if of_tool:
            self._of_tool.data = tool_speed(timed, self._panels.chain)
            return
        times, (position, *rates) = sampled(timed)
        rows = (position - self._middle, *rates)
        chosen = QUANTITIES.index(self._choice.value)
        self._of_plan.data = (times, *(100 * rows[chosen] / self._limits[chosen]).T)

    def _draw_torque(self, plan: Plan, timed: TimedTrajectory) -> None:
        """Ask the planner, and show what it answers if that is still wanted."""
        try:
            found = torque_shares(self._panels.robot, timed)
            said = "the URDF does not state the inertia of each link, and efforts" if found is None else ""
        except ZarmError as error:
            found, said = None, str(error)
        if plan is not self._plan or self._choice.value != TORQUE:
            return
        self._of_plan.visible, self._unknown.visible = found is not None, found is None
        if found is not None:
            self._of_plan.data = found
        self._unknown.content = f"torque unknown: {said}"


def torque_shares(robot: Robot, timed: TimedTrajectory) -> tuple[Array, ...] | None:
    """Times (K,) in s, and for each joint the torque (K,) there in % of its effort, 0 if that is unknown; None if all are. Raises the planner's error."""
    times = np.linspace(0.0, timed.duration, TORQUE_SAMPLES)
    position, velocity, acceleration = timed.sample(times).tolist()
    found = robot.inverse_dynamics(position, velocity=velocity, acceleration=acceleration)
    if found.torque is None or found.effort is None or not any(found.effort):
        return None
    efforts = [np.inf if effort is None else effort for effort in found.effort]
    return times, *(100.0 * np.array(found.torque) / efforts).T


def tool_speed(timed: TimedTrajectory, chain: Chain) -> tuple[Array, Array]:
    """Times (K,) in s, and the speed (K,) of the tip there in m/s."""
    times = np.linspace(0.0, timed.duration, TOOL_SAMPLES + 1)
    tips = np.array([chain.tip(row).translation() for row in timed.positions(times)])
    return (times[1:] + times[:-1]) / 2, np.linalg.norm(np.diff(tips, axis=0), axis=1) / np.diff(times)


def sampled(timed: TimedTrajectory) -> tuple[Array, tuple[Array, Array, Array, Array]]:
    """Times (K,) in s, and position, velocity, acceleration and jerk (K, J) there, in rad/s^n.

    The times are those of the samples and half-way between: jerk lasts a few ms, and even times would miss it.
    """
    times = np.sort(np.concatenate((timed.time, timed.time[:-1] + timed.steps / 2)))
    position, velocity, acceleration = timed.sample(times)
    return times, (position, velocity, acceleration, timed.jerks(times))
