"""The scene and the robot's spheres as markers, for RViz."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from geometry_msgs.msg import Point, Quaternion, Vector3
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from zarm_contract.descriptor import RobotDescriptor
from zarm_contract.messages import Capsule, Cuboid, Cylinder, Mesh, Scene, SceneObject, Sphere, Voxels
from zarm_ros_bridge.convert.colours import Colour

OBSTACLE: Colour = (0.8, 0.5, 0.2, 0.8)
CARRIED: Colour = (0.3, 0.7, 0.4, 0.8)
SPHERE: Colour = (0.2, 0.5, 0.9, 0.35)


def obstacle_markers(scene: Scene, base_link: str, tip_link: str, colours: Mapping[str, Colour]) -> MarkerArray:
    """Everything in the scene, replacing what was shown before; attached objects move with the tip, or their link."""
    markers = [Marker(action=Marker.DELETEALL)]
    for item in scene.objects:
        markers += _object(item, base_link, colours.get(item.name, OBSTACLE))
    for attached in scene.attached:
        markers += _object(attached.object, attached.link or tip_link, colours.get(attached.object.name, CARRIED))
    return MarkerArray(markers=markers)


def sphere_markers(robot: RobotDescriptor) -> MarkerArray:
    """The robot's collision spheres, each in the frame of its link, so that they move with it."""
    markers: list[Marker] = []
    for link, spheres in robot.spheres.items():
        for sphere in spheres:
            marker = _marker(link, "collision_spheres", len(markers), SPHERE, Marker.SPHERE)
            marker.frame_locked = True
            marker.pose.position = Point(x=sphere.center[0], y=sphere.center[1], z=sphere.center[2])
            marker.scale = _cube(2 * sphere.radius)
            markers.append(marker)
    return MarkerArray(markers=markers)


def _object(item: SceneObject, frame: str, colour: Colour) -> Iterator[Marker]:
    match item:
        case Cuboid():
            yield _placed(item, frame, 0, colour, Marker.CUBE, Vector3(x=item.size[0], y=item.size[1], z=item.size[2]))
        case Sphere():
            yield _placed(item, frame, 0, colour, Marker.SPHERE, _cube(2 * item.radius))
        case Cylinder():
            yield _placed(item, frame, 0, colour, Marker.CYLINDER, _round(item.radius, item.length))
        case Capsule():
            yield _placed(item, frame, 0, colour, Marker.CYLINDER, _round(item.radius, item.length))
            for index, side in enumerate((-0.5, 0.5), start=1):
                end = _placed(item, frame, index, colour, Marker.SPHERE_LIST, _cube(2 * item.radius))
                end.points = [Point(z=side * item.length)]
                yield end
        case Voxels():
            cubes = _placed(item, frame, 0, colour, Marker.CUBE_LIST, _cube(item.resolution))
            cubes.points = [
                Point(x=i * item.resolution, y=j * item.resolution, z=k * item.resolution) for i, j, k in item.cells
            ]
            yield cubes
        case Mesh():
            yield _mesh(item, frame, colour)


def _mesh(item: Mesh, frame: str, colour: Colour) -> Marker:
    """The mesh if its file is found here as well, otherwise its name in its place."""
    folders = [Path(folder) for folder in os.environ.get("ZARM_MESHES", "").split(os.pathsep) if folder]
    file = next((path for folder in folders if (path := folder / item.file).is_file()), None)
    if file is None:
        text = _placed(item, frame, 0, colour, Marker.TEXT_VIEW_FACING, Vector3(z=0.05))
        text.text = item.name
        return text
    marker = _placed(
        item, frame, 0, colour, Marker.MESH_RESOURCE, Vector3(x=item.scale[0], y=item.scale[1], z=item.scale[2])
    )
    marker.mesh_resource = file.resolve().as_uri()
    return marker


def _placed(item: Any, frame: str, index: int, colour: Colour, kind: int, scale: Vector3) -> Marker:
    marker = _marker(frame, item.name, index, colour, kind)
    marker.scale = scale
    marker.pose.position = Point(x=item.position[0], y=item.position[1], z=item.position[2])
    if not isinstance(item, Sphere):
        x, y, z, w = item.orientation
        marker.pose.orientation = Quaternion(x=x, y=y, z=z, w=w)
    return marker


def _marker(frame: str, namespace: str, index: int, colour: Colour, kind: int) -> Marker:
    red, green, blue, alpha = colour
    marker = Marker(
        ns=namespace, id=index, type=kind, action=Marker.ADD, color=ColorRGBA(r=red, g=green, b=blue, a=alpha)
    )
    marker.header.frame_id = frame
    return marker


def _cube(edge: float) -> Vector3:
    return Vector3(x=edge, y=edge, z=edge)


def _round(radius: float, length: float) -> Vector3:
    return Vector3(x=2 * radius, y=2 * radius, z=length)
