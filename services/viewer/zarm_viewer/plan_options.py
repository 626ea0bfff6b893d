"""The options of a plan request in its panel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, cast

from zarm.planner import ProgramOptions, Settings
from zarm.values import AXES, PathConstraint
from zarm_contract.messages import PlannerSettings
from zarm_viewer.controls import put
from zarm_viewer.panel_context import PanelContext

_DEFAULT = PlannerSettings()
_HOLD = "What is ticked stays as it is at the start, all the way"
_PLANNER = (
    "classic: the pose, in whatever branch; joint_space: the branch that is shown; multi_point: through the waypoints"
)
_REPLAN = "When something is put in the way, plan anew in motion and swerve; else the robot waits until the way is free"


class PlanOptions:
    """Inputs for how a plan is made and executed."""

    def __init__(self, panels: PanelContext) -> None:
        gui, default = panels.server.gui, _DEFAULT
        self._planner = gui.add_dropdown("planner", [default.planner], initial_value=default.planner, hint=_PLANNER)
        self._replan = gui.add_checkbox("replan on the way", False, hint=_REPLAN)
        self._velocity = gui.add_slider("velocity", 0.05, 1.0, 0.05, default.velocity_scale)
        self._acceleration = gui.add_slider("acceleration", 0.05, 1.0, 0.05, default.acceleration_scale)
        self._margin = gui.add_number("margin (m)", default.margin, min=0.0, max=0.2, step=0.001)
        self._timeout = gui.add_number("timeout (s)", default.timeout, min=0.1, max=60.0, step=0.5)
        self._attempts = gui.add_number("attempts", default.max_attempts, min=1, max=1000, step=1)
        self._optimize = gui.add_number("optimise (s)", default.optimize_s, min=0.0, max=30.0, step=0.01)
        self._held = {axis: gui.add_checkbox(f"hold {axis}", False, hint=_HOLD) for axis in AXES}
        self._frame = gui.add_dropdown("hold in", ["base", "tool"])

    def offer(self, planners: Sequence[str]) -> None:
        """Offer the planners of these names."""
        put(self._planner, tuple(planners), "options")

    @property
    def replan(self) -> bool:
        """Whether the servo may replan in motion."""
        return self._replan.value

    @property
    def of_program(self) -> ProgramOptions:
        """Those of the chosen settings that a program has."""
        return ProgramOptions(
            velocity_scale=self._velocity.value,
            acceleration_scale=self._acceleration.value,
            margin=self._margin.value,
            timeout=self._timeout.value,
            max_attempts=int(self._attempts.value),
        )

    @property
    def settings(self) -> Settings:
        """The chosen settings of the plan."""
        return Settings(
            planner=self._planner.value,
            velocity_scale=self._velocity.value,
            acceleration_scale=self._acceleration.value,
            margin=self._margin.value,
            timeout=self._timeout.value,
            max_attempts=int(self._attempts.value),
            optimize_s=self._optimize.value,
        )

    @property
    def to_pose(self) -> bool:
        """Whether the goal is the pose of the tip, and the planner chooses the joint positions that reach it."""
        return self._planner.value == "classic" or self.path_constraint is not None

    @property
    def path_constraint(self) -> PathConstraint | None:
        """The axes of the tip that are held, if any."""
        held = [axis for axis, box in self._held.items() if box.value]
        frame = cast(Literal["base", "tool"], self._frame.value)
        return PathConstraint(held, frame=frame) if held else None
