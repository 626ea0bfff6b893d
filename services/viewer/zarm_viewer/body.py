"""The look of links: visual meshes if the URDF's files exist, else a smooth body around the exact geometry."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence

from viser.transforms import SE3

from zarm_contract.robot import RobotDescription
from zarm_geometry.visual_meshes import VisualMesh, visual_meshes
from zarm_viewer.drawing import Shape, link_mesh, surface
from zarm_viewer.skin import skin

log = logging.getLogger(__name__)

Body = Mapping[str, tuple[Shape, ...]]
"""The shapes of each link, in its frame."""


def body_of(robot: RobotDescription) -> Body:
    """The robot's look."""
    visuals = visual_meshes(robot.urdf_path)
    return {link: _shapes_of(robot, link, visuals.get(link, ())) for link in {*visuals, *robot.descriptor.collision}}


def _shapes_of(robot: RobotDescription, link: str, visuals: Sequence[VisualMesh]) -> tuple[Shape, ...]:
    try:
        meshes = tuple((surface(visual.triangles()), SE3.identity()) for visual in visuals)
    except (ValueError, OSError) as error:
        log.warning("visual mesh not drawn link=%s reason=%s", link, error)
        meshes = ()
    if not meshes and (primitives := robot.descriptor.collision.get(link)):
        smooth = skin(primitives)
        return ((link_mesh(primitives) if smooth is None else smooth, SE3.identity()),)
    return meshes
