"""The scene of a robot: obstacles and attached objects."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import TypeAdapter, ValidationError

from zarm.connection import Connection
from zarm.objects import object_of
from zarm.values import invalid, joints_of, numbers
from zarm_contract.codec import decode
from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import (
    Attached,
    Name,
    ObjectPose,
    Occupancy,
    OccupancyRequest,
    PointCloud,
    SceneEdit,
    SceneEdited,
    SceneObject,
)
from zarm_contract.messages import Scene as SceneMessage
from zarm_runtime import clock

if TYPE_CHECKING:
    from zarm.values import Numbers, Pose

EDIT_SECONDS = 30.0
"""Longest wait for an edit: a large mesh takes seconds to read."""
_NAME: TypeAdapter[str] = TypeAdapter(Name)
_BATCH_SECONDS = 65.0  # the planner gives itself 60 s


@dataclass(frozen=True)
class Scene:
    """The scene of one robot, `robot.scene`. Poses are in the robot's base frame, lengths in m.

    Each edit is applied as a whole or not at all, and returns the new revision and the number of objects. Every method
    raises InvalidRequest for invalid arguments, and Unavailable if no planner answers.
    """

    connection: Connection

    def add(self, *objects: SceneObject | PointCloud, replace: bool = False) -> SceneEdited:
        """Add objects. A name that is taken is refused unless `replace`; the name of an attached object is always
        refused."""
        return self._edit(op="add", objects=objects, replace=replace)

    def remove(self, *names: str) -> SceneEdited:
        """Remove objects by name; detach attached ones first."""
        return self._edit(op="remove", names=names)

    def clear(self) -> SceneEdited:
        """Remove every object. Attached objects and ignored links stay."""
        return self._edit(op="clear")

    def attach(
        self,
        name: str,
        *,
        touch_links: Iterable[str] = (),
        joints: Numbers | None = None,
        link: str | None = None,
        mass: float | None = None,
        center: Numbers | None = None,
    ) -> SceneEdited:
        """Attach an object of the scene to the tip, or to a `link`; it keeps its pose relative to that at `joints`.

        `joints` (rad) are by default the measured ones. The object may touch `touch_links`, such as a gripper's
        fingers. A mesh or voxel object is attached as at most 32 cuboids that contain it. With its `mass` (kg) plans keep the
        largest torques of the joints; its `center` is in the frame of the object (m; default: its middle).
        """
        touch, at = tuple(touch_links), joints_of(joints, "joints")
        middle = None if center is None else numbers(center, "center")
        return self._edit(op="attach", name=name, touch_links=touch, joints=at, link=link, mass=mass, center=middle)

    def detach(self, name: str, *, joints: Numbers | None = None) -> SceneEdited:
        """Detach an object and leave it where it is with the robot at `joints` (rad; default: the measured ones)."""
        return self._edit(op="detach", name=name, joints=joints_of(joints, "joints"))

    def mount(self, tool: str) -> SceneEdited:
        """Mount a tool of the robot's descriptor, in place of the one on its link. From then on poses are of its tip.

        Raises Busy while the robot moves.
        """
        return self._edit(op="mount", tool=tool)

    def unmount(self, tool: str) -> SceneEdited:
        """Take a tool off that carries nothing. Raises Busy while the robot moves."""
        return self._edit(op="unmount", tool=tool)

    def set_link_collision(self, *links: str, enabled: bool) -> SceneEdited:
        """Turn collision checking of these links on or off; at least one link stays checked."""
        return self._edit(op="links", names=links, enabled=enabled)

    def set_object_collision(self, *names: str, enabled: bool) -> SceneEdited:
        """Turn collision checking of these objects, also of attached ones, on or off."""
        return self._edit(op="objects", names=names, enabled=enabled)

    def set_pair_collision(self, *pairs: tuple[str, str], enabled: bool) -> SceneEdited:
        """Turn collision checking of these pairs on or off: of a link or an attached object with an object, or of two of the former."""
        return self._edit(op="pairs", names=pairs, enabled=enabled)

    def move(
        self,
        name: str,
        pose: Pose,
        *,
        speed: float,
        velocity: Numbers | None = None,
        angular: Numbers | None = None,
        stamp: float | None = None,
    ) -> None:
        """Publish the present pose of an object of the scene, at up to 100 Hz. There is no answer, and it is not an
        edit.

        The object is expected to move on with `velocity` (m/s) and `angular` (rad/s), and its true velocity to be
        within `speed` (m/s) of that. For an object that may turn around at any time give only `speed`, its maximum.
        `stamp` is the time of the pose (Unix time, s; default: now). Keep publishing, even at rest: after 1 s without a
        pose the object counts as lost. `servo/state` reports that, and why a pose was refused.
        """
        fields = {
            "stamp": clock.unix_time() if stamp is None else stamp,
            "position": pose.position,
            "orientation": pose.orientation,
            "linear": (0.0,) * 3 if velocity is None else numbers(velocity, "velocity"),
            "angular": (0.0,) * 3 if angular is None else numbers(angular, "angular"),
            "speed": speed,
        }
        try:
            known = _NAME.validate_python(name)
        except ValidationError:
            raise InvalidRequest(f"{name!r} cannot be the name of an object", field="name") from None
        try:
            message = ObjectPose.model_validate(fields)
        except ValidationError as error:
            raise invalid("the pose", error, fields) from None
        self.connection.publisher(self.connection.keys.object_pose(known)).put(message)

    def load(self, file: str | Path) -> SceneEdited:
        """Replace every object by those of a YAML file as `save` writes it: a list `objects` with the fields of each.

        Raises InvalidRequest that names the file, the line and the field at fault.
        """
        from zarm_contract.document import read_document

        document = read_document(Path(file), "a scene")
        if set(document.data) != {"objects"}:
            raise InvalidRequest(f"{file}: a scene is a mapping with the one key `objects`, a list")
        try:
            edit = decode(SceneEdit, json.dumps({"edit": {"op": "load", **document.data}}).encode())
        except InvalidRequest as error:
            field = (error.problem.field or "").removeprefix("edit.")
            raise InvalidRequest(f"{document.place(field)}: {error.problem.message}", field=field or None) from error
        return self.apply(edit)

    def save(self, file: str | Path) -> int:
        """Write the objects to a YAML file that `load` reads. Returns how many; attached objects are left out."""
        from yaml import safe_dump

        objects = json.loads(self.read().model_dump_json(include={"objects"}))
        try:
            Path(file).write_text(safe_dump(objects, sort_keys=False, default_flow_style=None), encoding="utf-8")
        except OSError as error:
            raise InvalidRequest(f"cannot write {file}: {error.strerror}") from error
        return len(objects["objects"])

    def objects(self) -> Mapping[str, SceneObject]:
        """The objects by name, without attached ones."""
        return {item.name: object_of(item) for item in self.read().objects}

    def attached(self) -> Mapping[str, Attached]:
        """The attached objects by name; their poses are in the frame of the tip, or of their `link`."""
        return {carried.object.name: carried for carried in self.read().attached}

    def read(self) -> SceneMessage:
        """The whole scene as one message."""
        return self.connection.read(self.connection.keys.scene)

    def occupancy(self, resolution: float = 0.05) -> Occupancy:
        """The cubes with edges of `resolution` m that objects occupy."""
        try:
            request = OccupancyRequest(resolution=resolution)
        except ValidationError as error:
            raise invalid("occupancy", error) from None
        return self.connection.ask(self.connection.keys.occupancy, request, timeout=_BATCH_SECONDS)

    def apply(self, edit: SceneEdit, *, timeout: float = EDIT_SECONDS) -> SceneEdited:
        """Apply an edit given as a message."""
        return self.connection.ask(self.connection.keys.scene_edit, edit, timeout=timeout)

    def _edit(self, **edit: object) -> SceneEdited:
        data = {"edit": edit}
        try:
            request = SceneEdit.model_validate(data)
        except ValidationError as error:
            raise invalid("the edit", error, data) from None
        return self.apply(request)
