"""The parameter world_file: a scene read from a file on the bridge's machine."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from zarm_contract.codec import decode
from zarm_contract.errors import InvalidRequest, ZarmError, from_problem
from zarm_contract.messages import SceneEdit
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.parameters import Parameters

_KINDS = ("cuboid", "sphere", "cylinder", "mesh")


class WorldFile:
    """Loads the file when world_file changes, replacing the objects in the scene; an empty name leaves the scene alone."""

    def __init__(self, engine: Engine, parameters: Parameters) -> None:
        self._engine = engine
        parameters.on_change("world_file", self._load)

    def _load(self, name: str) -> None:
        if not name:
            return
        path = Path(name)
        try:
            load = {"edit": {"op": "load", "objects": list(_objects(_read(path)))}}
            request = decode(SceneEdit, json.dumps(load, default=str).encode())
            self._engine.client.scene.apply(request)
        except ZarmError as error:
            problem = error.problem
            field = problem.field and problem.field.removeprefix("edit.")
            raise from_problem(
                problem.model_copy(update={"message": f"{path}: {problem.message}", "field": field})
            ) from error


def _read(path: Path) -> Mapping[str, Any]:
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:  # also for a null character in the path
        raise InvalidRequest(f"cannot be read: {error}") from error
    except yaml.YAMLError as error:
        raise InvalidRequest(f"is not valid YAML: {' '.join(str(error).split())}") from error
    if not isinstance(data, dict):
        raise InvalidRequest(
            "is not a mapping; a scene has the key objects, a world of cuRobo the kinds of its obstacles"
        )
    return data


def _objects(data: Mapping[str, Any]) -> Iterator[Any]:
    """The objects of a scene saved by `zarm scene save`, or of a cuRobo world."""
    if set(data) == {"objects"}:
        if not isinstance(data["objects"], list):
            raise InvalidRequest("is no list", field="objects")
        yield from data["objects"]
        return
    for kind, named in data.items():
        if kind not in _KINDS:
            raise InvalidRequest(
                f"{kind} is not a kind of obstacle that is read from a file; those are {', '.join(_KINDS)}"
            )
        if not isinstance(named, dict):
            raise InvalidRequest("is not a mapping of names to obstacles", field=str(kind))
        for name, obstacle in named.items():
            try:
                yield {"kind": kind, "name": name, **_obstacle(kind, obstacle)}
            except (KeyError, TypeError, ValueError) as error:
                raise InvalidRequest(
                    f"the {kind} {name} is not as in a world of cuRobo: {error}; see docs/reference/ros.md"
                ) from error


def _obstacle(kind: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """cuRobo's fields in zarm's names; a cuRobo pose is x, y, z and then the quaternion w, x, y, z."""
    if kind == "sphere":
        return {"position": (given.get("pose") or given["position"])[:3], "radius": given["radius"]}
    x, y, z, qw, qx, qy, qz = given["pose"]
    place = {"position": (x, y, z), "orientation": (qx, qy, qz, qw)}
    if kind == "cuboid":
        return place | {"size": given["dims"]}
    if kind == "cylinder":
        return place | {"radius": given["radius"], "length": given["height"]}
    return place | {"file": given["file_path"], "scale": given.get("scale") or (1.0, 1.0, 1.0)}
