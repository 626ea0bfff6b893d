"""Edits of the scene, answered."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from zarm_contract.errors import Busy, InvalidRequest
from zarm_contract.messages import (
    AttachObject,
    DetachObject,
    MountTool,
    Scene,
    SceneEdit,
    SetLinkCollision,
    SetObjectCollision,
    SingleEdit,
    UnmountTool,
)
from zarm_planner.goals.joints import checked
from zarm_planner.handlers.state import PlannerState
from zarm_planner.scene.attached_objects import carrier, check_attach, check_links
from zarm_planner.scene.tools import at_tool, refuse_shapes
from zarm_trajectory.arrays import Array


class SceneHandlers:
    """Answers requests that change the scene. `moves` tells whether the robot is in motion, or about to be."""

    def __init__(self, state: PlannerState, moves: Callable[[], bool]) -> None:
        self._state, self._moves = state, moves

    def edit(self, request: SceneEdit) -> Scene:
        """Apply an edit of the scene and return the result.

        Raises InvalidRequest for a faulty edit, Busy for a tool while the robot moves, ExecutionRefused if it needs joints and
        nothing is measured, and Unavailable if it cannot be saved; then nothing has changed.
        """
        openings = self._state.grippers.present()
        return self._state.store.edit(
            request, self._complete, lambda scene: self._state.scenes.prepare(scene, openings)
        )

    def _complete(self, scene: Scene, edit: SingleEdit) -> tuple[SingleEdit, Array]:
        """Check an edit of a scene, and fill it in; also the pose (4, 4) of the link to which an object is attached, or was."""
        match edit:
            case MountTool() | UnmountTool() if self._moves():
                raise Busy(
                    f"the robot is in motion with the tip that it has; {edit.op} {edit.tool} once it stands still"
                )
            case SetObjectCollision():
                refuse_shapes(scene, edit.names, "edit.names.{}")
            case SetLinkCollision():
                check_links(self._state.model.links, edit.names, "edit.names")
                if not edit.enabled and {*self._state.model.links} <= {*edit.names, *scene.ignored_links}:
                    raise InvalidRequest(
                        "this would turn off collision checking for every link; keep at least one",
                        field="edit.names",
                    )
            case AttachObject():
                check_attach(self._state.model.links, edit.name, edit.touch_links, "edit")
                edit = at_tool(self._state.model.robot, scene, edit)
                return edit, self._pose(scene, edit)
            case DetachObject():
                refuse_shapes(scene, (edit.name,), "edit.name")
                return edit, self._pose(scene, edit)
        return edit, np.eye(4)

    def _pose(self, scene: Scene, edit: AttachObject | DetachObject) -> Array:
        """The pose (4, 4) of the link that carries an object where the robot is."""
        model = self._state.model
        q = self._state.measured() if edit.joints is None else checked(model, edit.joints, "edit.joints")
        return model.fk_link(carrier(model, scene, edit), q)
