"""Edits of the scene, answered."""

from __future__ import annotations

from collections.abc import Callable

from zarm_contract.errors import Busy, InvalidRequest
from zarm_contract.messages import (
    AttachObject,
    DetachObject,
    MountTool,
    Scene,
    SceneEdit,
    SetLinkCollision,
    SetObjectCollision,
    UnmountTool,
)
from zarm_planner.goals.joints import checked
from zarm_planner.handlers.state import PlannerState
from zarm_planner.scene.attached_objects import carrier, check_attach, check_links
from zarm_planner.scene.tools import at_tool, refuse_shapes


class SceneHandlers:
    """Answers requests that change the scene. `moves` tells whether the robot is in motion, or about to be."""

    def __init__(self, state: PlannerState, moves: Callable[[], bool]) -> None:
        self._state, self._moves = state, moves

    def edit(self, request: SceneEdit) -> Scene:
        """Apply an edit of the scene and return the result.

        Raises InvalidRequest for a faulty edit, Busy for a tool while the robot moves, ExecutionRefused if it needs joints and
        nothing is measured, and Unavailable if it cannot be saved; then nothing has changed.
        """
        match request.edit:
            case MountTool() | UnmountTool() as edit if self._moves():
                raise Busy(
                    f"the robot is in motion with the tip that it has; {edit.op} {edit.tool} once it stands still"
                )
            case SetObjectCollision(names=names):
                refuse_shapes(self._state.store.scene, names, "edit.names.{}")
            case SetLinkCollision(names=names, enabled=enabled):
                check_links(self._state.model.links, names, "edit.names")
                if not enabled and {*self._state.model.links} <= {*names, *self._state.store.scene.ignored_links}:
                    raise InvalidRequest(
                        "this would turn off collision checking for every link; keep at least one",
                        field="edit.names",
                    )
            case AttachObject(name=name, touch_links=touch_links) as edit:
                check_attach(self._state.model.links, name, touch_links, "edit")
                return self._at_joints(at_tool(self._state.model.robot, self._state.store.scene, edit))
            case DetachObject(name=name) as edit:
                refuse_shapes(self._state.store.scene, (name,), "edit.name")
                return self._at_joints(edit)
        return self._state.store.edit(request, prepare=self._state.scenes.prepare)

    def _at_joints(self, edit: AttachObject | DetachObject) -> Scene:
        """An edit that depends on where the robot is."""
        q = self._state.measured() if edit.joints is None else checked(self._state.model, edit.joints, "edit.joints")
        openings = self._state.grippers.present()
        return self._state.store.edit(
            SceneEdit(edit=edit),
            lambda scene: self._state.model.fk_link(carrier(self._state.model, scene, edit), q),
            lambda scene: self._state.scenes.prepare(scene, openings),
        )
