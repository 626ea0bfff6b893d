"""The robot as bodies, joints and geoms of MuJoCo."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np

from zarm_contract.messages import Vector3
from zarm_contract.robot import RobotDescription
from zarm_contract.urdf import Inertial, Joint
from zarm_physics_sim.shapes import link_geom, of_rpy
from zarm_trajectory.arrays import Array

LINK = "link "
SEEN, UNSEEN = 0, 3
"""Groups of geoms: what is rendered, and what is not."""
_LEAST_MASS = 1e-6
_LEAST_INERTIA = 1e-9
"""Of a link that has neither geometry nor a stated inertia (kg, kg m²)."""


_POINT = (_LEAST_INERTIA, _LEAST_INERTIA, _LEAST_INERTIA, 0.0, 0.0, 0.0)
"""Of a mass in a point."""


def link_body(link: str) -> str:
    """The name of the body of a link: MuJoCo has a body `world`, as many robots have a link."""
    return LINK + link


def payload_name(link: str) -> str:
    """The body of what is mounted on a link."""
    return f"payload of {link}"


def add_robot(
    spec: mujoco.MjSpec,
    robot: RobotDescription,
    inertials: dict[str, Inertial],
    density: float,
    looks: Mapping[str, Array],
) -> None:
    """Add the links with their exact geometry; those without an inertial get a `density` (kg/m³). What cameras see of a link are its triangles (n, 3, 3)
    in `looks`, else that geometry.

    Joints have their names in the URDF. The joints of the arm and those of the grippers move within their
    limits; what follows a gripper's joint is held to it.
    """
    descriptor, urdf = robot.descriptor, robot.urdf
    moving = {*descriptor.joints}
    followers: dict[str, tuple[str, float, float]] = {}
    for gripper in descriptor.grippers.values():
        for name, (multiplier, offset) in gripper.joints(urdf).items():
            moving.add(name)
            if name != gripper.joint:
                followers[name] = (gripper.joint, multiplier, offset)
    children: dict[str, list[Joint]] = {}
    for joint in urdf.joint_of_child.values():
        children.setdefault(joint.parent, []).append(joint)

    def add(parent: Any, link: str, joint: Joint | None) -> None:
        pose = {} if joint is None else {"pos": list(joint.xyz), "quat": of_rpy(joint.rpy)}
        body = parent.add_body(name=link_body(link), **pose)
        if joint is not None and joint.name in moving:
            _add_joint(body, joint)
        shapes = descriptor.collision.get(link, ())
        for shape in shapes:
            body.add_geom(density=density, group=UNSEEN if link in looks else SEEN, **link_geom(shape))
        if link in looks:
            _add_look(spec, body, link, looks[link])
        if (inertial := inertials.get(link)) is not None:
            _set_inertia(body, inertial.mass, inertial.xyz, of_rpy(inertial.rpy), inertial.inertia)
        elif not shapes:
            _set_inertia(body, _LEAST_MASS, (0.0, 0.0, 0.0), [1.0, 0.0, 0.0, 0.0], _POINT)
        if (payload := descriptor.payloads.get(link)) is not None:
            add_mass(body, payload_name(link), payload.mass, payload.center)
        for child in children.get(link, ()):
            add(body, child.child, child)

    add(spec.worldbody, descriptor.base_link, None)
    for one, other in descriptor.self_collision_ignore:
        spec.add_exclude(bodyname1=link_body(one), bodyname2=link_body(other))
    for name, (driver, multiplier, offset) in followers.items():
        spec.add_equality(
            type=mujoco.mjtEq.mjEQ_JOINT, objtype=mujoco.mjtObj.mjOBJ_JOINT, name1=name, name2=driver,
            data=[offset, multiplier, *[0.0] * (mujoco.mjNEQDATA - 2)],
        )  # fmt: skip


def add_mass(body: Any, name: str, mass: float, center: Vector3) -> None:
    """Add a `mass` (kg) to a body, as a point at its `center` (m)."""
    mounted = body.add_body(name=name, pos=list(center))
    _set_inertia(mounted, mass, (0.0, 0.0, 0.0), [1.0, 0.0, 0.0, 0.0], _POINT)


def _add_look(spec: mujoco.MjSpec, body: Any, link: str, triangles: Array) -> None:
    corners = np.arange(3 * len(triangles), dtype=np.int32)
    shell = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # it need not enclose a volume
    mesh = spec.add_mesh(name=f"look of {link}", uservert=triangles.ravel(), userface=corners, inertia=shell)
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh.name, group=SEEN, contype=0, conaffinity=0, mass=0.0)


def _add_joint(body: Any, joint: Joint) -> None:
    slides = joint.type == "prismatic"
    kind = mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE
    limits = (
        {} if joint.lower is None or joint.upper is None else {"range": [joint.lower, joint.upper], "limited": True}
    )
    body.add_joint(name=joint.name, type=kind, axis=list(joint.axis), **limits)


def _set_inertia(body: Any, mass: float, center: Any, orientation: list[float], inertia: Any) -> None:
    body.explicitinertial = True
    body.mass, body.ipos, body.iquat, body.fullinertia = mass, list(center), orientation, list(inertia)
