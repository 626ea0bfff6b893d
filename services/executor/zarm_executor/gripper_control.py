"""The goal of one gripper, from its command until the fingers stand."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass

from zarm_contract.errors import Busy, InvalidRequest, Problem, Unavailable
from zarm_contract.gripper import Gripper
from zarm_contract.messages import GripperRequest, GripperState, GripperStatus
from zarm_executor.gripper_links import GripperLink
from zarm_runtime import clock

_MOVED = 2e-4
"""An opening that has changed by more than this (m) has moved: position sensors of grippers resolve 0.1 mm and better."""


@dataclass
class _Goal:
    """A goal; `moved_at` (s, monotonic) is when the fingers were last seen to move, first its start."""

    goal_id: str
    target: float
    began: float
    from_width: float | None
    seen_width: float | None
    moved_at: float
    moved: bool = False


class GripperControl:
    """One gripper, moved through `link`, or by nothing if that is None; `touch_links` are as in `GripperState`. Thread-safe."""

    def __init__(
        self, name: str, gripper: Gripper, link: GripperLink | None, touch_links: tuple[str, ...] = ()
    ) -> None:
        self._name, self._gripper, self._link = name, gripper, link
        self._touch_links = touch_links
        self._goal: _Goal | None = None
        self._last: tuple[GripperStatus, str | None, float | None, Problem | None] = ("idle", None, None, None)
        self._lock = threading.Lock()

    @property
    def moving(self) -> bool:
        """Whether a goal moves it."""
        return self._goal is not None

    def start(self, request: GripperRequest, goal_id: str) -> None:
        """Start a goal. Raises Busy while another one moves the fingers, InvalidRequest for one that they cannot reach, and
        Unavailable if nothing can move them.
        """
        width = self._target(request)
        force, speed = request.force or self._gripper.force, request.speed or self._gripper.speed
        for field, value, most in (("force", force, self._gripper.force), ("speed", speed, self._gripper.speed)):
            if value > most:
                raise InvalidRequest(f"{self._name} has a {field} of at most {most:g}; ask for no more", field=field)
        with self._lock:
            if self._link is None:
                raise Unavailable(f"the active strategy moves nothing, and {self._name} neither; switch to another one")
            if self._goal is not None:
                if not request.preempt:
                    raise Busy(
                        f"{self._name} moves for {self._goal.goal_id}; wait for its end, cancel it, or set preempt"
                    )
                self._end("cancelled", Problem(code="cancelled", message=f"{goal_id} took its place"))
            before, now = self._width(), clock.monotonic()
            self._goal = _Goal(goal_id, width, now, before, before, now)
            self._link.command(self._gripper.position(width), speed * self._gripper.joint_speed, force)

    def cancel(self, why: str) -> None:
        """Stop the fingers where they are, if a goal moves them."""
        with self._lock:
            if self._goal is None:
                return
            measured = None if self._link is None else self._link.measured()
            if self._link is not None and measured is not None:
                self._link.command(measured[0], self._gripper.speed * self._gripper.joint_speed, self._gripper.force)
            self._end("cancelled", Problem(code="cancelled", message=why))

    def switch(self, link: GripperLink | None) -> None:
        """From now on move it through this link; no goal moves it."""
        with self._lock:
            self._link = link

    def tick(self, now: float, dt: float) -> None:
        """One period of `dt` s, at `now` (s, monotonic)."""
        with self._lock:
            if self._link is None:
                return
            self._link.tick(dt)
            if self._goal is not None:
                self._watch(self._goal, self._link, now)

    def state(self) -> GripperState:
        """Its state now."""
        with self._lock:
            goal = self._goal
            status, goal_id, target, problem = (
                self._last if goal is None else ("moving", goal.goal_id, goal.target, None)
            )
            measured = None if self._link is None else self._link.measured()
            return GripperState(
                gripper=self._name,
                status=status,
                widths=(self._gripper.closed, self._gripper.open),
                touch_links=self._touch_links,
                width=self._width(),
                position=None if measured is None else measured[0],
                goal_id=goal_id,
                target=target,
                problem=problem,
            )

    def _watch(self, goal: _Goal, link: GripperLink, now: float) -> None:
        """End the goal if the fingers stand, or the driver says so."""
        gripper, report, width = self._gripper, link.report(), self._width()
        if report is not None:
            if report.problem is not None:
                self._abort(f"the driver of {self._name} reports: {report.problem}")
            else:
                self._end("reached" if report.reached else "stalled")
            return
        measured = link.measured()
        seen_at = max(goal.began, -1.0 if measured is None else measured[1])
        if now - seen_at > gripper.driver_timeout:
            self._abort(
                f"the driver of {self._name} has reported nothing for {gripper.driver_timeout:g} s (driver_timeout); see whether it runs"
            )
            return
        if width is None:
            return
        if abs(width - goal.target) <= gripper.tolerance:
            self._end("reached")
        elif goal.seen_width is None or abs(width - goal.seen_width) > _MOVED:
            goal.moved = goal.moved or goal.seen_width is not None
            goal.seen_width, goal.moved_at = width, now
        elif goal.moved and now - goal.moved_at > gripper.stall_timeout:
            self._end("stalled")
        elif now - goal.moved_at > gripper.driver_timeout:
            self._never_moved(goal, width)

    def _never_moved(self, goal: _Goal, width: float) -> None:
        """Fingers that were already stopped by something do not close further; others should have moved."""
        if self._last[0] == "stalled" and goal.target < width:
            self._end("stalled")
        else:
            self._abort(
                f"the fingers of {self._name} have not moved for {self._gripper.driver_timeout:g} s (driver_timeout); see whether its driver "
                "takes commands"
            )

    def _target(self, request: GripperRequest) -> float:
        gripper = self._gripper
        if request.position is not None:
            _demand_within(request.position, sorted(gripper.positions), "position", f"the joint of {self._name}")
            return gripper.width(request.position)
        if request.width is None:
            raise InvalidRequest("there is neither a width nor a position; give one of them", field="width")
        _demand_within(request.width, gripper.widths, "width", f"the opening of {self._name} (m)")
        return request.width

    def _width(self) -> float | None:
        measured = None if self._link is None else self._link.measured()
        return None if measured is None else self._gripper.width(measured[0])

    def _abort(self, why: str) -> None:
        self._end("aborted", Problem(code="driver_stalled", message=why))

    def _end(self, status: GripperStatus, problem: Problem | None = None) -> None:
        if self._goal is not None:
            self._last = status, self._goal.goal_id, self._goal.target, problem
            self._goal = None


def _demand_within(value: float, ends: Sequence[float], field: str, what: str) -> None:
    if not ends[0] <= value <= ends[-1]:
        raise InvalidRequest(
            f"{what} goes from {ends[0]:g} to {ends[-1]:g}, not to {value:g}; give one in between", field=field
        )
