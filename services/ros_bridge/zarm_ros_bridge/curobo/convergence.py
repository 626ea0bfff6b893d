"""How far a robot in closed loop is from its target, and whether it counts as on target."""

from __future__ import annotations

from dataclasses import dataclass

from zarm_contract.messages import ServoSession


@dataclass(frozen=True)
class Convergence:
    """Errors of the measured tip (m, rad), and for how many steps both have been within their thresholds.

    `progress` (0 to 1) is the share by which the largest error since the target was set has been reduced.
    """

    position_error: float = 0.0
    orientation_error: float = 0.0
    hold_count: int = 0
    on_target: bool = False
    progress: float = 0.0


class Approach:
    """Evaluates one goal. It is on target once the errors are below `position` (m) and `orientation` (rad) for
    `hold_steps` steps of `step` s.
    """

    def __init__(self, *, position: float, orientation: float, hold_steps: int, step: float) -> None:
        self._position, self._orientation = position, orientation
        self._hold_steps, self._step = hold_steps, step
        self._since: float | None = None  # when both errors fell below their thresholds
        self._largest = 0.0

    def begin(self) -> None:
        """The target has moved."""
        self._since, self._largest = None, 0.0

    def judge(self, state: ServoSession | None, now: float) -> Convergence:
        """The convergence from the servo's report on the present target at `now` (s); None: no report on that target
        yet.
        """
        if state is None or state.position_error is None or state.orientation_error is None:
            return Convergence()
        error = max(state.position_error / self._position, state.orientation_error / self._orientation)
        self._largest = max(self._largest, error)
        if error > 1.0:
            self._since = None
            held = 0
        else:
            self._since = now if self._since is None else self._since
            held = 1 + int((now - self._since) / self._step)
        on_target = held >= self._hold_steps
        progress = 1.0 if on_target else 1.0 - error / self._largest
        return Convergence(state.position_error, state.orientation_error, held, on_target, progress)
