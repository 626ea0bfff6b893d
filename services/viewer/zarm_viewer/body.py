"""The look of links: visual meshes (STL, OBJ, COLLADA) if the URDF's files exist, else a smooth body around the exact geometry."""

from __future__ import annotations

import logging
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from viser.transforms import SE3, SO3

from zarm_contract.robot import RobotDescription
from zarm_viewer.drawing import Shape, file_mesh, link_mesh
from zarm_viewer.skin import skin

log = logging.getLogger(__name__)

Body = Mapping[str, tuple[Shape, ...]]
"""The shapes of each link, in its frame."""
_FORMATS = (".stl", ".obj", ".dae")


@dataclass(frozen=True)
class _Visual:
    """A visual mesh, in the frame of its link."""

    file: Path
    scale: tuple[float, float, float]
    at: SE3


def body_of(robot: RobotDescription) -> Body:
    """The robot's look."""
    visuals = _visuals(robot.urdf_path)
    return {link: _shapes_of(robot, link, visuals.get(link, ())) for link in {*visuals, *robot.descriptor.collision}}


def _shapes_of(robot: RobotDescription, link: str, visuals: tuple[_Visual, ...]) -> tuple[Shape, ...]:
    try:
        meshes = tuple((file_mesh(visual.file, visual.scale), visual.at) for visual in visuals)
    except (ValueError, OSError) as error:
        log.warning("visual mesh not drawn link=%s reason=%s", link, error)
        meshes = ()
    if not meshes and (primitives := robot.descriptor.collision.get(link)):
        smooth = skin(primitives)
        return ((link_mesh(primitives) if smooth is None else smooth, SE3.identity()),)
    return meshes


def _visuals(urdf: Path) -> dict[str, tuple[_Visual, ...]]:
    """The visual meshes of each link; a link is left out if one of its visuals is not a mesh or is not available here."""
    found: dict[str, tuple[_Visual, ...]] = {}
    for link in ET.parse(urdf).getroot().findall("link"):  # noqa: S314 - the robot's own file, read by load_robot before
        visuals = [_visual(element, urdf.parent) for element in link.findall("visual")]
        known = tuple(visual for visual in visuals if visual is not None)
        if known and len(known) == len(visuals):
            found[link.get("name", "")] = known
    return found


def _visual(element: ET.Element, folder: Path) -> _Visual | None:
    mesh, at = element.find("geometry/mesh"), element.find("origin")
    if mesh is None:
        return None
    file = folder / mesh.get("filename", "").removeprefix("file://")
    if file.suffix.lower() not in _FORMATS or not file.is_file():
        return None
    x, y, z = _numbers(mesh.get("scale", "1 1 1"))
    place = SE3.identity()
    if at is not None:
        turn = SO3.from_rpy_radians(*_numbers(at.get("rpy", "0 0 0")))
        place = SE3.from_rotation_and_translation(turn, np.array(_numbers(at.get("xyz", "0 0 0"))))
    return _Visual(file, (x, y, z), place)


def _numbers(text: str) -> tuple[float, float, float]:
    x, y, z = map(float, text.split())
    return x, y, z
