"""Grippers by structure: one driven joint behind the arm, joints that mimic it, and how far the fingers open."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import fcl
import numpy as np

from zarm_robot_import.chain import Chain
from zarm_robot_import.contacts import mesh_object
from zarm_robot_import.description import Description, Joint
from zarm_robot_import.meshes import Surface
from zarm_trajectory.arrays import Array

_STEPS = 25
"""Positions of the driven joint in which the opening is measured."""
_MIN_STROKE = 0.004
"""A gripper opens at least this far (m)."""
_OPENING_TOLERANCE = 2e-4
"""Openings (m) that differ by less are the same."""
_STRAIGHT = 2e-4
"""How far (m) the opening may be from the straight line between two given ones."""


@dataclass(frozen=True)
class ImportedGripper:
    """A gripper as the descriptor describes it. `followers` are the multiplier and offset of joints that mimic `joint`.

    `travel` is how far (m) a point of each of its links moves at most between closed and open; `moving` are these links.
    """

    joint: Joint
    followers: Mapping[str, tuple[float, float]]
    positions: tuple[float, ...]
    widths: tuple[float, ...]
    pads: tuple[str, ...]
    travel: Mapping[str, float]

    @property
    def speed(self) -> float | None:
        """How fast the opening changes (m/s) at the velocity limit of the joint, if it has one."""
        if not self.joint.velocity:
            return None
        return self.joint.velocity * (self.widths[-1] - self.widths[0]) / abs(self.positions[-1] - self.positions[0])

    @property
    def moving(self) -> Collection[str]:
        """Links that move with it."""
        return self.travel.keys()


def find_gripper(
    robot: Description, chain: Chain, surfaces: Sequence[Surface], fixed: Collection[str]
) -> ImportedGripper | None:
    """The gripper behind the arm; None where the joints there have several drives, are `fixed` by the user, or the fingers do not
    open.
    """
    joints = {joint.name: joint for joint in robot.joint_of_child.values()}
    names = [name for name in chain.gripper if joints[name].type != "fixed"]
    drives = [name for name in names if joints[name].mimic is None]
    if len(drives) != 1 or any(name in fixed for name in names):
        return None
    driven = joints[drives[0]]
    followers = {name: follows for name in names if (follows := _follows(joints, name, driven.name)) is not None}
    low, high = driven.lower, driven.upper
    if low is None or high is None or not low < high or driven.name not in followers or len(followers) != len(names):
        return None
    carrier = chain.carriers[-1]
    moving = [
        link
        for link in robot.below(carrier)
        if link != carrier and any(j.name in followers for j in _path(robot, carrier, link))
    ]
    fingers = {surface.link: surface.triangles for surface in surfaces if surface.link in moving}
    if not fingers:
        return None
    values = np.linspace(low, high, _STEPS)
    poses = [_poses(robot, chain, followers, value, moving) for value in values]
    pads, widths = _opening(robot, chain, fingers, poses, {surface.link: surface.triangles for surface in surfaces})
    if pads is None or np.ptp(widths) < _MIN_STROKE:
        return None
    if widths[0] > widths[-1]:
        values, widths = values[::-1], widths[::-1]
    positions, openings = _monotonic(values, widths)
    if len(positions) < 2 or openings[-1] - openings[0] < _MIN_STROKE:
        return None
    del followers[driven.name]
    return ImportedGripper(driven, followers, positions, openings, pads, _travel(fingers, moving, poses))


def _follows(joints: Mapping[str, Joint], name: str, driven: str) -> tuple[float, float] | None:
    """Multiplier and offset by which a joint follows the driven one, through others if need be."""
    multiplier, offset, seen = 1.0, 0.0, set[str]()
    while name != driven:
        mimic = joints[name].mimic if name in joints else None
        if mimic is None or name in seen:
            return None
        seen.add(name)
        offset += multiplier * mimic[2]
        multiplier *= mimic[1]
        name = mimic[0]
    return multiplier, offset


def _path(robot: Description, base: str, link: str) -> list[Joint]:
    return robot.path(base, link) or []


def _poses(
    robot: Description, chain: Chain, followers: Mapping[str, tuple[float, float]], value: float, moving: Sequence[str]
) -> dict[str, Array]:
    """The pose (4, 4) of each link relative to the last link of the arm, with the driven joint at `value`."""
    placed = {mounted.link: mounted.pose for mounted in chain.mounted}
    stands = dict(chain.fixed)
    for link in moving:
        joint = robot.joint_of_child[link]
        multiplier, offset = followers.get(joint.name, (0.0, stands.get(joint.name, 0.0)))
        placed[link] = placed[joint.parent] @ joint.moved(multiplier * value + offset)
    return placed


def _opening(
    robot: Description,
    chain: Chain,
    fingers: Mapping[str, Array],
    poses: Sequence[Mapping[str, Array]],
    every: Mapping[str, Array],
) -> tuple[tuple[str, str] | None, Array]:
    """The two pads, and the opening (steps,) between them in m.

    The pads are the two links of different branches whose distance changes most; for a jaw beside a fixed one, the opening is
    how far the jaw's outermost point has moved.
    """
    carrier = chain.carriers[-1]
    branch = {link: next(j.child for j in _path(robot, carrier, link) if j.type != "fixed") for link in fingers}
    objects = {link: mesh_object(triangles) for link, triangles in fingers.items()}
    best: tuple[tuple[str, str] | None, Array] = (None, np.zeros(len(poses)))
    links = list(fingers)
    for i, one in enumerate(links):
        for other in links[i + 1 :]:
            if branch[one] != branch[other]:
                widths = np.array([_distance(objects, one, other, placed) for placed in poses])
                if np.ptp(widths) > np.ptp(best[1]) + _OPENING_TOLERANCE:
                    best = (one, other), widths
    if best[0] is not None or len(links) != 1:
        return best
    (jaw,) = links
    across = robot.joint_of_child[jaw].parent
    points = fingers[jaw].reshape(-1, 3)
    far = np.append(points[np.argmax(np.linalg.norm(points, axis=1))], 1.0)
    tips = np.array([(placed[jaw] @ far)[:3] for placed in poses])
    palm = mesh_object(every[across]) if across in every else None
    if palm is None:
        return None, best[1]
    gaps = [_gap(palm, placed[across], placed[jaw] @ far) for placed in (poses[0], poses[-1])]
    closed = 0 if gaps[0] <= gaps[1] else -1
    return (jaw, across), np.linalg.norm(tips - tips[closed], axis=1)


def _distance(objects: Mapping[str, fcl.CollisionObject], one: str, other: str, placed: Mapping[str, Array]) -> float:
    for link in (one, other):
        objects[link].setTransform(fcl.Transform(placed[link][:3, :3], placed[link][:3, 3]))
    if fcl.collide(objects[one], objects[other], fcl.CollisionRequest(), fcl.CollisionResult()):
        return 0.0
    return max(0.0, float(fcl.distance(objects[one], objects[other], fcl.DistanceRequest(), fcl.DistanceResult())))


def _gap(palm: fcl.CollisionObject, at: Array, tip: Array) -> float:
    """The distance (m) of the outermost point of a jaw to what it closes on."""
    point = fcl.CollisionObject(fcl.Sphere(1e-4), fcl.Transform(np.eye(3), tip[:3]))
    palm.setTransform(fcl.Transform(at[:3, :3], at[:3, 3]))
    return float(fcl.distance(palm, point, fcl.DistanceRequest(), fcl.DistanceResult()))


def _monotonic(values: Array, widths: Array) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """As few positions and openings as describe the way from closed to open; of a jaw that is closed over a part of its way only the
    end of that.
    """
    first = int(np.flatnonzero(widths <= widths.min() + _OPENING_TOLERANCE)[-1])
    last = int(np.flatnonzero(widths >= widths.max() - _OPENING_TOLERANCE)[0])
    if last <= first or np.any(np.diff(widths[first : last + 1]) <= 0.0):
        return (), ()
    kept, at = [first], first
    while at < last:
        ahead = last
        while ahead > at + 1 and not _straight(values, widths, at, ahead):
            ahead -= 1
        kept.append(at := ahead)
    return tuple(np.round(values[kept], 9).tolist()), tuple(np.round(widths[kept], 5).tolist())


def _straight(values: Array, widths: Array, first: int, last: int) -> bool:
    share = (values[first : last + 1] - values[first]) / (values[last] - values[first])
    line = widths[first] + share * (widths[last] - widths[first])
    return bool(np.abs(widths[first : last + 1] - line).max() <= _STRAIGHT)


def _travel(
    fingers: Mapping[str, Array], moving: Sequence[str], poses: Sequence[Mapping[str, Array]]
) -> dict[str, float]:
    travel = dict.fromkeys(moving, 0.0)
    for link, triangles in fingers.items():
        points = np.column_stack([triangles.reshape(-1, 3), np.ones(3 * len(triangles))])
        placed = np.array([points @ pose[link].T for pose in (poses[0], poses[len(poses) // 2], poses[-1])])
        travel[link] = math.sqrt(
            max(float(((placed[i] - placed[j])[:, :3] ** 2).sum(axis=1).max()) for i, j in ((0, 1), (0, 2), (1, 2)))
        )
    return travel
