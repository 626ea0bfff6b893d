"""Edits of the scene, answered."""

from __future__ import annotations

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import (
    AttachObject,
    DetachObject,
    Scene,
    SceneEdit,
    SetLinkCollision,
)
from zarm_planner.goals.joints import checked
from zarm_planner.handlers.state import PlannerState
from zarm_planner.scene.attached_objects import carrier, check_attach, check_links


class SceneHandlers:
    """Answers requests that change the scene."""

    def __init__(self, state: PlannerState) -> None:
        self._state = state

    def edit(self, request: SceneEdit) -> Scene:
        """Apply an edit of the scene and return the result.

        Raises InvalidRequest for a faulty edit, ExecutionRefused if it needs joints and nothing is measured, and
        Unavailable if it cannot be saved; then nothing has changed.
        """
        match request.edit:
            case SetLinkCollision(names=names, enabled=enabled):
                check_links(self._state.model.links, names, "edit.names")
                if not enabled and {*self._state.model.links} <= {*names, *self._state.store.scene.ignored_links}:
                    raise InvalidRequest(
                        "this would turn off collision checking for every link; keep at least one",
                        field="edit.names",
                    )
            case AttachObject(name=name, touch_links=touch_links):
                check_attach(self._state.model.links, name, touch_links, "edit")
        if not isinstance(request.edit, AttachObject | DetachObject):
            return self._state.store.edit(request, prepare=self._state.scenes.prepare)
        given = request.edit.joints
        q = self._state.measured() if given is None else checked(self._state.model, given, "edit.joints")
        openings = self._state.grippers.present()
        edit = request.edit
        return self._state.store.edit(
            request,
            lambda scene: self._state.model.fk_link(carrier(self._state.model, scene, edit), q),
            lambda scene: self._state.scenes.prepare(scene, openings),
        )
