"""Requests as clients of MoveIt make them, and what MoveIt's documentation says of the answer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from moveit_msgs.msg import (
    BoundingVolume,
    Constraints,
    JointConstraint,
    MotionPlanRequest,
    MoveItErrorCodes,
    OrientationConstraint,
    PositionConstraint,
)
from moveit_msgs.srv import GetMotionPlan
from scipy.spatial.transform import Rotation
from shape_msgs.msg import SolidPrimitive

from support.ros.client import RosClient

SUCCESS = MoveItErrorCodes.SUCCESS
DOWN = (1.0, 0.0, 0.0, 0.0)


def position(
    at: Sequence[float],
    link: str = "link_6",
    *,
    radius: float | None = 0.001,
    box: Sequence[float] | None = None,
    frame: str = "base_link",
    turned: Sequence[float] = (0.0, 0.0, 0.0, 1.0),
    offset: Sequence[float] = (0.0, 0.0, 0.0),
) -> Any:
    """A point of a link is in a ball, or in a box with these edges."""
    shape = (
        SolidPrimitive(type=SolidPrimitive.SPHERE, dimensions=[radius])
        if box is None
        else SolidPrimitive(type=SolidPrimitive.BOX, dimensions=list(box))
    )
    x, y, z = map(float, at)
    region = BoundingVolume(
        primitives=[shape], primitive_poses=[Pose(position=Point(x=x, y=y, z=z), orientation=quaternion(turned))]
    )
    dx, dy, dz = map(float, offset)
    made = PositionConstraint(
        link_name=link, constraint_region=region, target_point_offset=Vector3(x=dx, y=dy, z=dz), weight=1.0
    )
    made.header.frame_id = frame
    return made


def orientation(
    q: Sequence[float],
    link: str = "link_6",
    *,
    tolerance: Sequence[float] = (0.001, 0.001, 0.001),
    frame: str = "base_link",
    rotation_vector: bool = False,
) -> Any:
    """A link is turned so."""
    x, y, z = map(float, tolerance)
    made = OrientationConstraint(
        link_name=link,
        orientation=quaternion(q),
        absolute_x_axis_tolerance=x,
        absolute_y_axis_tolerance=y,
        absolute_z_axis_tolerance=z,
        parameterization=int(rotation_vector),
        weight=1.0,
    )
    made.header.frame_id = frame
    return made


def joints(names: Sequence[str], values: Sequence[float], tolerance: float = 0.001) -> Any:
    """Joints are here."""
    return Constraints(
        joint_constraints=[
            JointConstraint(
                joint_name=name, position=float(value), tolerance_above=tolerance, tolerance_below=tolerance, weight=1.0
            )
            for name, value in zip(names, values, strict=True)
        ]
    )


def pose(at: Sequence[float], q: Sequence[float] = DOWN, link: str = "link_6", **options: Any) -> Any:
    """A link is in this pose."""
    turn = {key: options.pop(key) for key in ("tolerance", "rotation_vector") if key in options}
    frame = options.get("frame", "base_link")
    return Constraints(
        position_constraints=[position(at, link, **options)],
        orientation_constraints=[orientation(q, link, frame=frame, **turn)],
    )


def request(*goals: Any, **fields: Any) -> Any:
    """A request as pymoveit2 makes it."""
    return MotionPlanRequest(
        **{
            "group_name": "arm",
            "goal_constraints": list(goals),
            "num_planning_attempts": 5,
            "allowed_planning_time": 20.0,
            **fields,
        }
    )


def planned(client: RosClient, wanted: Any) -> Any:
    """The answer of plan_kinematic_path."""
    return client.call(GetMotionPlan, "/plan_kinematic_path", motion_plan_request=wanted).motion_plan_response


def end_of(response: Any) -> list[float]:
    """The joints at the end of a plan."""
    assert response.error_code.val == SUCCESS, response.error_code
    return list(response.trajectory.joint_trajectory.points[-1].positions)


def quaternion(q: Sequence[float]) -> Quaternion:
    """A message."""
    x, y, z, w = map(float, q)
    return Quaternion(x=x, y=y, z=z, w=w)


def angles_off(wanted: Sequence[float], found: Sequence[float], *, rotation_vector: bool) -> np.ndarray:
    """By which a link is off, about each axis (rad): Euler angles XYZ or a rotation vector, in the frame that is wanted."""
    off = Rotation.from_quat(wanted).inv() * Rotation.from_quat(found)
    values = off.as_rotvec() if rotation_vector else off.as_euler("XYZ")
    return np.abs((values + math.pi) % (2 * math.pi) - math.pi)
