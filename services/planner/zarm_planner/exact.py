"""Exact distances of the robot to the scene and to itself, by FCL on the descriptor's collision primitives.

Along a motion they are found by adaptive bisection, for each pair of shapes on its own (Schwarzer, Saha and Latombe,
"Adaptive dynamic collision checking for single and multiple articulated robots in complex environments", 2005): on a
stretch of the motion the two come no nearer than their distance in its middle minus what they travel from there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import fcl
import numpy as np
from numpy.typing import ArrayLike, NDArray

from zarm_contract.messages import SceneObject
from zarm_planner.robot_model import RobotModel
from zarm_planner.shapes import Shape, depth, object_shape

Array = NDArray[np.float64]
Index = NDArray[np.intp]

RESOLUTION = 0.005
"""Along a motion whose samples are no further apart than this (m), nothing can reach further into anything unseen."""
FARTHEST = 1.0
"""Clearance (m) beyond which nobody asks."""
_RELIED = 0.98
"""Which part of FCL's distances is relied on. Of 100,000 random pairs of shapes 117 were measured more than 0.1 mm too
long, by 1.3 mm at worst; with this part 7 were, by 0.5 mm at worst."""
_DOUBT = 0.02
"""A bound within so much (m) of the best distance is replaced by the exact distance."""
_BLOCK = 8192
"""So many pairs are bounded at a time, for the sake of memory."""
_DISTANCE = fcl.DistanceRequest()
_IGNORED = fcl.DistanceResult(-math.inf)
"""Where FCL's bindings find nothing to improve, so that nearest points are not copied."""


@dataclass(frozen=True)
class Nearest:
    """The smallest distance (m): below 0 it is the depth of penetration, and at FARTHEST there is no `pair`.

    `pair` names a link and what is nearest to it, a scene object or another link; `sample` is the index of the
    configuration.
    """

    distance: float
    pair: tuple[str, str] | None
    sample: int


class ExactScene:
    """The robot's and the scene's exact geometry. Immutable, for use by any number of threads."""

    def __init__(self, model: RobotModel, objects: Sequence[SceneObject]) -> None:
        parts = model.parts
        obstacles = [object_shape(item) for item in objects]
        self.model = model
        self.parts = len(parts)
        self.shapes = [shape for _, shape in parts] + obstacles
        self.obstacles = [
            fcl.CollisionObject(shape.geometry, fcl.Transform(shape.pose[:3, :3], shape.pose[:3, 3]))
            for shape in obstacles
        ]

        # By index of shape, the robot's parts before the obstacles; a part's pose is in its link's frame.
        self.link = np.array([link for link, _ in parts], np.intp)
        self.pose = np.array([shape.pose for shape in self.shapes]).reshape(-1, 4, 4)
        self.half = np.array([shape.half for shape in self.shapes]).reshape(-1, 3)
        self.rounding = np.array([shape.rounding for shape in self.shapes])
        covers = [shape.balls() for _, shape in parts]
        most = max(len(centers) for centers, _ in covers)
        self.balls = np.array([np.pad(centers, ((0, most - len(centers)), (0, 0)), "edge") for centers, _ in covers])
        self.ball_radius = np.array([radius for _, radius in covers])
        grown = (np.abs(self.pose[:, :3, :3]) @ self.half[:, :, None])[..., 0] + self.rounding[:, None]
        boxes = np.stack([self.pose[:, :3, 3] - grown, self.pose[:, :3, 3] + grown], axis=1)
        self.boxes = boxes[self.parts :]
        # Between a ball and a rounded box the bound that balls give is the distance.
        self.is_ball = np.array([not shape.half.any() for _, shape in parts])
        self.is_box = np.array([shape.disc == 0.0 for shape in self.shapes])

        # By link: a sphere around it, and how far it travels with each joint; then the same travel for the pairs of links
        # that can meet, of the outer one as seen from the inner one.
        links = range(len(model.links))
        box_of = [boxes[: self.parts][self.link == link] for link in links]
        self.centers = np.array([(box[:, 0].min(axis=0) + box[:, 1].max(axis=0)) / 2 for box in box_of])
        self.radii = np.array(
            [
                np.linalg.norm(np.abs(box - center).max(axis=1), axis=1).max()
                for box, center in zip(box_of, self.centers, strict=True)
            ]
        )
        reach = _reach(model, [shape for _, shape in parts], self.link)
        by_link = np.array([reach[self.link == link].max(axis=0) for link in links])
        between = np.arange(model.dof) > model.link_joint[model.pairs[:, 0], None]
        self.travel_per_joint = np.concatenate([by_link, by_link[model.pairs[:, 1]] * between])
        self.reach = reach.max(axis=0)
        """(dof,): how far (m) a point of the robot moves at most per rad (m where prismatic) of each joint."""

        # Parts against the world, and each other: outer part, inner part, column of travel.
        self.movable = np.flatnonzero(model.link_joint[self.link] >= 0)
        self.pairs = np.array(
            [
                (outer, inner, len(links) + pair)
                for pair, (a, b) in enumerate(model.pairs.tolist())
                for inner in np.flatnonzero(self.link == a)
                for outer in np.flatnonzero(self.link == b)
            ],
            np.intp,
        ).reshape(-1, 3)

    def nearest(self, q: ArrayLike, stop: Callable[[], None] = lambda: None, *, itself: bool = True) -> Nearest:
        """The smallest distance over configurations `q` (n, dof) that follow each other closely, or over one (dof,).

        To objects and, if `itself`, of the robot's links to each other. The search ends at the first collisions that it
        finds; so the deepest is sure for a single configuration only. Links fixed to the base are not checked against the
        world. `stop` is called now and then and may raise.
        """
        return _Sweep(self, np.atleast_2d(np.asarray(q, np.float64))).nearest(stop, itself)


class _Sweep:
    """One look at an ExactScene along configurations (n, dof)."""

    def __init__(self, scene: ExactScene, q: Array) -> None:
        self._scene = scene
        self._links = scene.model.link_transforms(q)
        self._travel = np.zeros((len(q), len(scene.travel_per_joint)))
        np.cumsum(np.abs(np.diff(q, axis=0)) @ scene.travel_per_joint.T, axis=0, out=self._travel[1:])
        self._parts = [fcl.CollisionObject(shape.geometry) for shape in scene.shapes[: scene.parts]]

    def nearest(self, stop: Callable[[], None], itself: bool) -> Nearest:
        shapes, travel = self._scene.shapes, self._travel
        a, b, row, best = self._candidates(itself)
        # Stretches low <= k < high of each pair's samples, of which the middle one is looked at.
        low, high = np.zeros(len(a), np.intp), np.full(len(a), len(travel))
        while len(a):
            stop()
            k = (low + high) // 2
            spread = np.maximum(travel[k, row] - travel[low, row], travel[high - 1, row] - travel[k, row])
            distance = self._lower_bounds(a, b, k)
            known = self._scene.is_ball[a] & self._scene.is_box[b] & (distance > 0.0)
            for i in np.argsort(distance, kind="stable").tolist():
                above = distance[i] - max(best.distance, 0.0)
                if above >= _DOUBT:
                    break
                if above >= 0.0 and not above < spread[i] < _DOUBT:
                    continue  # the exact distance would settle nothing
                if not known[i]:
                    distance[i] = self._distance(int(a[i]), int(b[i]), int(k[i]))
                if distance[i] < best.distance:
                    best = Nearest(float(distance[i]), (shapes[a[i]].name, shapes[b[i]].name), int(k[i]))
            if best.distance <= 0.0:
                break
            split = (_RELIED * distance - spread < best.distance) & (spread > RESOLUTION / 2)
            a, b, row = (np.tile(x[split], 2) for x in (a, b, row))
            low, high = np.append(low[split], k[split] + 1), np.append(k[split], high[split])
            a, b, row, low, high = (x[low < high] for x in (a, b, row, low, high))
        return best

    def _candidates(self, itself: bool) -> tuple[Index, Index, Index, Nearest]:
        """Pairs of shapes that may come near, with their column of travel, and a first distance to beat.

        Boxes around all places of the spheres around links, against boxes around obstacles.
        """
        scene, movable = self._scene, self._scene.movable
        places = np.einsum("nlij,lj->nli", self._links[:, :, :3, :3], scene.centers) + self._links[:, :, :3, 3]
        gap = np.maximum(
            (places.min(axis=0) - scene.radii[:, None])[:, None] - scene.boxes[:, 1],
            scene.boxes[:, 0] - (places.max(axis=0) + scene.radii[:, None])[:, None],
        ).clip(0.0)
        apart = np.sqrt(np.einsum("loi,loi->lo", gap, gap))[scene.link[movable]]
        best = Nearest(FARTHEST, None, 0)
        for flat in np.argsort(apart, axis=None, kind="stable")[:8].tolist():
            row, column = divmod(flat, apart.shape[1])
            a, b = int(movable[row]), scene.parts + column
            if (distance := self._distance(a, b, 0)) < best.distance:
                best = Nearest(distance, (scene.shapes[a].name, scene.shapes[b].name), 0)
        rows, columns = np.nonzero(apart < max(best.distance, 0.0) + _DOUBT)
        part, obstacle = movable[rows], scene.parts + columns
        if not itself:
            return part, obstacle, scene.link[part], best
        outer, inner, row_of_pair = scene.pairs.T
        return (
            np.append(part, outer),
            np.append(obstacle, inner),
            np.append(scene.link[part], row_of_pair),
            best,
        )

    def _lower_bounds(self, a: Index, b: Index, k: Index) -> Array:
        """Distances (m,) that parts `a` keep at least to shapes `b` at samples `k`: balls against rounded boxes."""
        scene = self._scene
        if len(a) > _BLOCK:
            blocks = range(0, len(a), _BLOCK)
            return np.concatenate([self._lower_bounds(*(x[i : i + _BLOCK] for x in (a, b, k))) for i in blocks])
        own = self._links[k, scene.link[a]] @ scene.pose[a]
        other = scene.pose[b]
        moving = b < scene.parts
        other[moving] = self._links[k[moving], scene.link[b[moving]]] @ other[moving]
        centers = scene.balls[a] @ own[:, :3, :3].transpose(0, 2, 1) + (own[:, :3, 3] - other[:, :3, 3])[:, None]
        outside = (np.abs(centers @ other[:, :3, :3]) - scene.half[b][:, None]).clip(0.0)
        nearest = np.sqrt(np.einsum("mbi,mbi->mb", outside, outside).min(axis=1))
        bounds: Array = nearest - scene.ball_radius[a] - scene.rounding[b]
        return bounds

    def _distance(self, a: int, b: int, k: int) -> float:
        """The exact distance of part `a` to shape `b` at sample `k`; below 0 the depth of penetration."""
        scene, pose = self._scene, self._part_pose(a, k)
        self._parts[a].setTransform(fcl.Transform(pose[:3, :3], pose[:3, 3]))
        if b >= scene.parts:
            pose_b, other = scene.pose[b], scene.obstacles[b - scene.parts]
        else:
            pose_b, other = self._part_pose(b, k), self._parts[b]
            other.setTransform(fcl.Transform(pose_b[:3, :3], pose_b[:3, 3]))
        distance: float = fcl.distance(self._parts[a], other, _DISTANCE, _IGNORED)
        return distance if distance > 0.0 else -depth(scene.shapes[a], pose, scene.shapes[b], pose_b)

    def _part_pose(self, part: int, k: int) -> Array:
        pose: Array = self._links[k, self._scene.link[part]] @ self._scene.pose[part]
        return pose


def _reach(model: RobotModel, parts: Sequence[Shape], link: Index) -> Array:
    """How far (parts, dof) a point of each part moves at most per rad (m where prismatic) of each joint.

    From the joint outwards, as if the arm could always stretch to a line.
    """
    slide = np.where(model.revolute, 0.0, np.maximum(abs(model.lower), abs(model.upper)))
    reach = np.zeros((len(parts), model.dof))
    for i, shape in enumerate(parts):
        pose = model.offset[link[i]] @ shape.pose
        extent = float(np.linalg.norm(pose[:3, 3])) + math.hypot(*shape.half) + shape.rounding
        for joint in range(int(model.link_joint[link[i]]), -1, -1):
            reach[i, joint] = extent if model.revolute[joint] else 1.0
            extent += float(np.linalg.norm(model.origin[joint, :, 3])) + slide[joint]
    return reach
