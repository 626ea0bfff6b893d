"""Services of the scene: obstacles, distances to them, and ignored link collisions."""

from __future__ import annotations

from collections.abc import MutableMapping
from typing import TYPE_CHECKING

from std_srvs.srv import Trigger

from zarm_contract.errors import InvalidRequest, ZarmError
from zarm_ros_bridge.answers import with_message, without_words
from zarm_ros_bridge.convert.colours import Colour, colour_of
from zarm_ros_bridge.convert.fields import in_terms_of
from zarm_ros_bridge.convert.joints import known_as
from zarm_ros_bridge.curobo.generations.generation import Generation
from zarm_ros_bridge.curobo.objects import FIELDS, fill_grid, name_of, object_of
from zarm_ros_bridge.curobo.parameters import Parameters
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.ros import Ros

if TYPE_CHECKING:
    from curobo_msgs.srv import (
        AddObject,
        GetCollisionDistance,
        GetVoxelGrid,
        RemoveObject,
        SetCollisionCache,
        SetLinkCollision,
    )

_SECONDS = 65.0
"""Longest wait (s) for work that the planner limits to 60 s."""
_MOST_COUNTED = 127
"""The greatest int8."""


class SceneServices:
    """add_object, remove_object, remove_all_objects, get_obstacles, get_voxel_grid, get_collision_distance,
    set_collision_cache and set_link_collision. `colours` holds the colours of objects by name for display; the scene
    has none.
    """

    def __init__(
        self,
        ros: Ros,
        engine: Engine,
        parameters: Parameters,
        colours: MutableMapping[str, Colour],
        generation: Generation,
    ) -> None:
        self._engine = engine
        self._generation = generation
        self._scene = engine.client.scene
        self._parameters = parameters
        self._colours = colours
        generation.serve(ros, "AddObject", "~/add_object", with_message(self._add))
        generation.serve(ros, "RemoveObject", "~/remove_object", with_message(self._remove))
        ros.serve(Trigger, "~/remove_all_objects", with_message(self._remove_all))
        ros.serve(Trigger, "~/get_obstacles", with_message(self._obstacles))
        generation.serve(ros, "GetVoxelGrid", "~/get_voxel_grid", without_words(self._voxels))
        generation.serve(ros, "GetCollisionDistance", "~/get_collision_distance", without_words(self._distance))
        generation.serve(ros, "SetCollisionCache", "~/set_collision_cache", with_message(self._cache))
        generation.serve(ros, "SetLinkCollision", "~/set_link_collision", with_message(self._links))

    def _add(self, request: AddObject.Request, _: AddObject.Response) -> str:
        item = object_of(request)
        colour, before = colour_of(request), self._colours.get(item.name)
        if colour is not None:  # known before the scene is published with the object
            self._colours[item.name] = colour
        try:
            edited = self._scene.add(item)
        except ZarmError as error:
            self._colours.pop(item.name, None)
            if before is not None:
                self._colours[item.name] = before
            raise in_terms_of(error, FIELDS) from error
        return f"Object '{item.name}' added; the scene has {edited.count}"

    def _remove(self, request: RemoveObject.Request, _: RemoveObject.Response) -> str:
        name = name_of(request.name)
        try:
            edited = self._scene.remove(name)
        except ZarmError as error:
            raise in_terms_of(error, {"edit.names.0": "name"}) from error
        self._colours.pop(name, None)
        return f"Object '{name}' removed; the scene has {edited.count}"

    def _remove_all(self, _: Trigger.Request, __: Trigger.Response) -> str:
        count = len(self._scene.read().objects)
        self._scene.clear()
        self._colours.clear()
        return f"All {count} obstacles removed"

    def _obstacles(self, _: Trigger.Request, __: Trigger.Response) -> str:
        return "\n".join(item.name for item in self._scene.read().objects)

    def _voxels(self, request: GetVoxelGrid.Request, response: GetVoxelGrid.Response) -> str:
        try:
            occupancy = self._scene.occupancy(self._parameters.value("voxel_size"))
        except ZarmError as error:
            raise in_terms_of(error, {"resolution": "voxel_size"}) from error
        fill_grid(
            response.voxel_grid, occupancy, self._engine.robot.descriptor.base_link, self._generation.box(request)
        )
        return ""

    def _distance(self, _: GetCollisionDistance.Request, response: GetCollisionDistance.Response) -> str:
        (result,) = self._engine.client.check(None, spheres=True, timeout=_SECONDS)
        response.data = list(result.spheres or ())
        response.nb_sphere = min(len(response.data), _MOST_COUNTED)
        return ""

    def _cache(self, request: SetCollisionCache.Request, response: SetCollisionCache.Response) -> str:
        kinds = ("obb", "mesh", "blox")
        try:
            for kind in kinds:
                if (count := getattr(request, kind)) < -1:
                    raise InvalidRequest(f"{count} is not a number of obstacles; -1 leaves it as it is", field=kind)
            for kind in kinds:
                if (count := getattr(request, kind)) >= 0:
                    self._parameters.set(f"{kind}_cache_size", count)
        finally:
            for kind in kinds:
                setattr(response, f"{kind}_cache", self._parameters.value(f"{kind}_cache_size"))
        return "noted; the scene takes obstacles of any kind up to its own limits, whatever these numbers are"

    def _links(self, request: SetLinkCollision.Request, response: SetLinkCollision.Response) -> str:
        if not request.link_names:
            raise InvalidRequest("name the links", field="link_names")
        known = self._engine.robot.descriptor.spheres
        asked = {name: known_as(name, known) for name in request.link_names}
        applied = [name for name, link in asked.items() if link in known]
        response.unknown_links = [name for name, link in asked.items() if link not in known]
        if applied:
            links = dict.fromkeys(asked[name] for name in applied)
            try:
                self._scene.set_link_collision(*links, enabled=request.enabled)
            except ZarmError as error:
                raise in_terms_of(error, {"edit.names": "link_names"}) from error
            response.applied_links = applied
        if response.unknown_links:
            raise InvalidRequest(
                f"{', '.join(response.unknown_links)} has no collision geometry or is no link; choose among {', '.join(known)}",
                field="link_names",
            )
        state = "looked at" if request.enabled else "no longer looked at"
        return f"collisions of {', '.join(applied)} are {state}"
