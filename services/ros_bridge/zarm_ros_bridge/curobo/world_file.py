"""The parameter world_file: a scene read from a file on the bridge's machine."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from zarm_contract.codec import decode
from zarm_contract.document import Document, read_document
from zarm_contract.errors import InvalidRequest, ZarmError, from_problem
from zarm_contract.messages import SceneEdit
from zarm_ros_bridge.curobo.parameters import Parameters
from zarm_ros_bridge.engine import Engine

_KEYS = {
    "cuboid": {"pose", "dims"},
    "sphere": {"pose", "position", "radius"},
    "cylinder": {"pose", "radius", "height"},
    "mesh": {"pose", "file_path", "scale"},
}
"""The kinds of obstacle that are read, and the keys of each."""
_IGNORED_KEYS = {"name", "color", "material", "texture", "texture_id", "tensor_args"}
"""Keys of cuRobo's obstacles that change neither place nor shape."""


class WorldFile:
    """Loads the file when world_file changes, replacing the objects in the scene; an empty name leaves the scene alone."""

    def __init__(self, engine: Engine, parameters: Parameters) -> None:
        self._engine = engine
        parameters.on_change("world_file", self._load)

    def _load(self, name: str) -> None:
        if not name:
            return
        document = read_document(Path(name), "a scene, or a world of cuRobo,")
        try:
            load = {"edit": {"op": "load", "objects": list(_objects(document))}}
            request = decode(SceneEdit, json.dumps(load).encode())
            self._engine.client.scene.apply(request)
        except ZarmError as error:
            problem = error.problem
            field = problem.field and problem.field.removeprefix("edit.")
            raise from_problem(
                problem.model_copy(update={"message": f"{document.path}: {problem.message}", "field": field})
            ) from error


def _objects(document: Document) -> Iterator[Any]:
    """The objects of a scene saved by `zarm scene save`, or of a cuRobo world."""
    data = document.data
    if set(data) == {"objects"}:
        if not isinstance(data["objects"], list):
            raise InvalidRequest("is no list", field="objects")
        yield from data["objects"]
        return
    for kind, named in data.items():
        if kind not in _KEYS:
            raise InvalidRequest(
                f"line {document.line((kind,))}: {kind} is not a kind of obstacle that is read from a file; those are "
                f"{', '.join(_KEYS)}"
            )
        if not isinstance(named, dict):
            raise InvalidRequest("is not a mapping of names to obstacles", field=kind)
        for name, obstacle in named.items():
            try:
                yield {"kind": kind, "name": name, **_obstacle(kind, obstacle)}
            except (KeyError, TypeError, ValueError) as error:
                raise InvalidRequest(
                    f"line {document.line((kind, name))}: the {kind} {name} is not as in a world of cuRobo: {error}; see "
                    "docs/reference/ros.md"
                ) from error


def _obstacle(kind: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """cuRobo's fields in zarm's names; a cuRobo pose is x, y, z and then the quaternion w, x, y, z.

    Raises KeyError, TypeError or ValueError for what is missing or unknown.
    """
    if unknown := sorted(set(given) - _KEYS[kind] - _IGNORED_KEYS):
        raise ValueError(f"{', '.join(unknown)} is not read here")
    if kind == "sphere":
        return {"position": (given.get("pose") or given["position"])[:3], "radius": given["radius"]}
    x, y, z, qw, qx, qy, qz = given["pose"]
    place = {"position": (x, y, z), "orientation": (qx, qy, qz, qw)}
    if kind == "cuboid":
        return place | {"size": given["dims"]}
    if kind == "cylinder":
        return place | {"radius": given["radius"], "length": given["height"]}
    return place | {"file": given["file_path"], "scale": given.get("scale") or (1.0, 1.0, 1.0)}
