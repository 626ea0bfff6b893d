"""The meshes published by a robot's maker, read by trimesh and placed in FCL: a second opinion on the result of an
import.
"""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import fcl
import numpy as np
import trimesh

from zarm_geometry.robot_model import RobotModel
from zarm_robot_import.description import Geometry, describe
from zarm_robot_import.source import Source, read_source


def original_meshes(file: Path) -> dict[str, np.ndarray]:
    """The triangles (n, 3, 3) of each link of a URDF or xacro: its collision geometry, or otherwise its visual one."""
    robot = describe(read_source(file))
    found = {}
    for link in robot.links.values():
        parts = [_triangles(robot.source, item) for item in link.collision or link.visual]
        if parts:
            found[link.name] = np.concatenate(parts)
    return found


def _triangles(source: Source, item: Geometry) -> np.ndarray:
    if item.kind == "mesh":
        file = source.file(item.file)
        assert file is not None
        mesh = trimesh.load_mesh(file, process=False)
        mesh.apply_scale(item.scale)
    elif item.kind == "cylinder":
        mesh = trimesh.creation.cylinder(*item.size)
    elif item.kind == "box":
        mesh = trimesh.creation.box(item.size)
    else:
        mesh = trimesh.creation.icosphere(radius=item.size[0])
    mesh.apply_transform(item.pose)
    return np.asarray(mesh.triangles)


class OriginalRobot:
    """A robot made of original meshes (n, 3, 3), by link."""

    def __init__(self, model: RobotModel, meshes: dict[str, np.ndarray]) -> None:
        self.model = model
        self._bodies = {link: _bvh(meshes[link]) for link in model.links}

    def placed(self, q: np.ndarray) -> dict[str, fcl.CollisionObject]:
        """The links at their poses for a configuration (dof,)."""
        return {
            link: fcl.CollisionObject(self._bodies[link], fcl.Transform(pose[:3, :3], pose[:3, 3]))
            for link, pose in zip(self.model.links, self.model.link_transforms(q), strict=True)
        }

    def contacts(self, q: np.ndarray) -> set[tuple[str, str]]:
        """Pairs of links in contact at a configuration (dof,), without adjacent ones and those rigidly connected."""
        objects = self.placed(q)
        bodies = dict(zip(self.model.links, self.model.link_joint.tolist(), strict=True))
        return {
            (one, other)
            for one, other in combinations(self.model.links, 2)
            if abs(bodies[one] - bodies[other]) > 1 and touch(objects[one], objects[other])
        }


def touch(one: fcl.CollisionObject, other: fcl.CollisionObject) -> bool:
    return bool(fcl.collide(one, other, fcl.CollisionRequest(), fcl.CollisionResult()))


def _bvh(triangles: np.ndarray) -> fcl.BVHModel:
    mesh = fcl.BVHModel()
    mesh.beginModel(len(triangles), 3 * len(triangles))
    mesh.addSubModel(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3))
    mesh.endModel()
    return mesh
