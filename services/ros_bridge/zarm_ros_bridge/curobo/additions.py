"""Services of generation C: clear plans and voxels, attach and detach objects, show collision spheres."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from zarm_contract.errors import InvalidRequest, ZarmError
from zarm_contract.messages import Voxels
from zarm_ros_bridge.answers import with_message
from zarm_ros_bridge.convert.fields import in_terms_of
from zarm_ros_bridge.curobo.motions import Motions
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.ros import Ros

log = logging.getLogger(__name__)


class Additions:
    """clear_trajectory, clear_voxel_map, attach_object, detach_object and set_collision_spheres_enabled.

    `show_spheres(enabled)` shows or hides the robot's collision spheres.
    """

    def __init__(self, ros: Ros, engine: Engine, motions: Motions, show_spheres: Callable[[bool], None]) -> None:
        self._scene = engine.client.scene
        self._motions = motions
        self._show_spheres = show_spheres
        ros.serve(Trigger, "~/clear_trajectory", with_message(self._clear_trajectory))
        ros.serve(Trigger, "~/clear_voxel_map", with_message(self._clear_voxels))
        ros.serve(Trigger, "~/detach_object", with_message(self._detach))
        ros.serve(SetBool, "~/set_collision_spheres_enabled", with_message(self._spheres))
        self._trajectory = ros.node.create_publisher(JointTrajectory, "trajectory", 10)
        if (kind := _attach_object()) is not None:
            ros.serve(kind, "~/attach_object", with_message(self._attach))

    def _clear_trajectory(self, _: Trigger.Request, __: Trigger.Response) -> str:
        self._motions.clear()
        self._trajectory.publish(JointTrajectory())
        return "Trajectory cleared"

    def _clear_voxels(self, _: Trigger.Request, __: Trigger.Response) -> str:
        names = [item.name for item in self._scene.read().objects if isinstance(item, Voxels)]
        if names:
            self._scene.remove(*names)
        return f"{len(names)} voxel objects removed"

    def _attach(self, request: Any, _: Any) -> str:
        try:
            self._scene.attach(request.object_name)
        except ZarmError as error:
            raise in_terms_of(error, {"edit.name": "object_name"}) from error
        return f"Object '{request.object_name}' attached"

    def _detach(self, _: Trigger.Request, __: Trigger.Response) -> str:
        names = [carried.object.name for carried in self._scene.read().attached if carried.tool is None]
        if not names:
            raise InvalidRequest("the robot carries nothing; call attach_object first")
        for name in names:
            self._scene.detach(name)
        return f"Object '{', '.join(names)}' detached"

    def _spheres(self, request: SetBool.Request, _: SetBool.Response) -> str:
        self._show_spheres(request.data)
        return f"Collision spheres {'enabled' if request.data else 'disabled'}"


def _attach_object() -> Any | None:
    """The type of attach_object, if the package is installed and has the expected fields."""
    try:
        from isaac_ros_cumotion_interfaces.srv import AttachObject
    except ImportError:
        log.info("not served reason=attach_object needs isaac_ros_cumotion_interfaces, which is not installed")
        return None
    fields = AttachObject.Request.get_fields_and_field_types(), AttachObject.Response.get_fields_and_field_types()
    if list(fields[0]) != ["object_name"] or not {"success", "message"} <= set(fields[1]):
        log.warning("not served reason=srv/AttachObject of isaac_ros_cumotion_interfaces has the fields %s", fields)
        return None
    return AttachObject
