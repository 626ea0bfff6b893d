"""The kinematic tree and collision spheres of the robot, packed into arrays."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Attached
from zarm_contract.robot import RobotDescription
from zarm_geometry.body import Body, along, attached_body, link_body
from zarm_geometry.kernels.arrays import RobotArrays
from zarm_geometry.kernels.broad_phase import Cover
from zarm_geometry.kernels.kinematics import frames
from zarm_geometry.kernels.simd import LANES
from zarm_geometry.self_margin import CONFIGURATIONS, pair_room
from zarm_geometry.shapes import Shape
from zarm_geometry.sphere_cover import sphere_cover

Array = NDArray[np.float64]

Openings = tuple[tuple[str, float], ...]
"""Grippers of a robot with their openings (m)."""

_COVER = 12
"""Most balls around an exact shape in the broad phase."""


@dataclass(frozen=True)
class RobotModel:
    """One robot in arrays; every joint vector follows the descriptor's `joints`, every pose is in its `base_link`.

    `lower`, `upper` (rad, m for a prismatic joint; infinite for a continuous one), `velocity`, `acceleration` and `jerk` have the shape (dof,).
    `bodies` are all collision bodies, in kinematic order, and `links` their names; `link_joint` (links,) is the moving
    joint that carries each, -1 for the base. `pairs` (n, 2) are the indices of those that can collide with each other:
    all except pairs that may touch, or belong to the same rigid body. `parts` are the exact shapes, each with the index
    of the link in whose frame it is.
    """

    robot: RobotDescription
    dof: int
    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    jerk: Array
    bodies: tuple[Body, ...]
    links: tuple[str, ...]
    link_joint: NDArray[np.int32]
    pairs: NDArray[np.int32]
    parts: tuple[tuple[int, Shape], ...]
    origin: Array
    revolute: NDArray[np.bool_]
    offset: Array
    weight: NDArray[np.float32]
    arrays: RobotArrays

    @classmethod
    def of(cls, robot: RobotDescription) -> Self:
        """Pack a robot without attached objects, its grippers open."""
        descriptor = robot.descriptor
        origins, tip = along(robot.urdf.chain(descriptor.base_link, descriptor.tip_link), {})
        grippers = robot.gripper_positions({})
        bodies = [link_body(robot, link, grippers) for link in descriptor.spheres]
        return cls._packed(robot, np.array(origins), tip, bodies)

    def with_attached(
        self, attached: Sequence[Attached], ignored_links: Sequence[str], openings: Openings = ()
    ) -> Self:
        """This robot with one more body for each attached object, without the ignored links, and with grippers at these
        `openings`; those left out are open.

        The object is fixed to the tip and named as in the scene; it may touch its `touch_links`.
        """
        grippers = self.robot.descriptor.grippers
        openings = tuple((name, width) for name, width in openings if width != grippers[name].open)
        if not attached and not ignored_links and not openings:
            return self
        tip = self.offset[-1]
        bodies = [body for body in self._at(openings) if body.name not in ignored_links]
        bodies += [attached_body(item, self.dof, tip) for item in attached]
        return self._packed(self.robot, self.origin, tip, bodies)

    def _at(self, openings: Openings) -> list[Body]:
        """The links, those of the grippers at these openings."""
        if not openings:
            return list(self.bodies)
        positions = self.robot.gripper_positions(dict(openings))
        return [
            link_body(self.robot, body.name, positions)
            if any(
                joint.name in positions for joint in self.robot.urdf.chain(self.robot.descriptor.base_link, body.name)
            )
            else body
            for body in self.bodies
        ]

    @classmethod
    def _packed(cls, robot: RobotDescription, origin: Array, tip: Array, bodies: Sequence[Body]) -> Self:
        """The model of a robot with these bodies; `origin` (dof, 3, 4) and `tip` (4, 4) as in `body.along`."""
        descriptor = robot.descriptor
        # In kinematic order, so that kernels finish the links of one joint before they go on to the next.
        bodies = sorted(bodies, key=lambda body: body.joint)
        link_joint = np.array([body.joint for body in bodies], np.int32)
        moving = {joint.name: joint for joint in robot.urdf.joint_of_child.values()}
        revolute = np.array([moving[name].type != "prismatic" for name in descriptor.joints])
        pairs = [
            (i, j)
            for (i, a), (j, b) in combinations(enumerate(bodies), 2)
            if a.joint != b.joint and a.name not in b.touches and b.name not in a.touches
        ]
        left = {frozenset(pair) for pair in descriptor.self_collision_exact}
        searched = [(i, j) for i, j in pairs if frozenset((bodies[i].name, bodies[j].name)) not in left]
        pair_array = np.array(pairs, np.int32).reshape(-1, 2)
        lower, upper = np.array(robot.lower), np.array(robot.upper)
        spheres = [body.placed_balls for body in bodies]
        reach = _reach(origin, revolute, np.maximum(abs(lower), abs(upper)), link_joint, spheres)
        return cls(
            robot=robot,
            dof=len(descriptor.joints),
            lower=lower,
            upper=upper,
            velocity=np.array(descriptor.cspace.velocity),
            acceleration=np.array(descriptor.cspace.acceleration),
            jerk=np.array(descriptor.cspace.jerk),
            bodies=tuple(bodies),
            links=tuple(body.name for body in bodies),
            link_joint=link_joint,
            pairs=pair_array,
            parts=tuple((i, shape) for i, body in enumerate(bodies) for shape in body.shapes),
            origin=origin,
            revolute=revolute,
            offset=np.array([*(body.pose for body in bodies), tip]),
            weight=_weight(reach),
            arrays=RobotArrays(
                origin=origin.astype(np.float32),
                revolute=revolute.astype(np.uint8),
                link_joint=link_joint,
                link_first=np.cumsum([0, *(len(balls) for balls in spheres)], dtype=np.int32),
                spheres=np.concatenate([np.empty((0, 4)), *spheres]).astype(np.float32),
                bounds=np.array([_bounding_sphere(balls) for balls in spheres], np.float32).reshape(-1, 4),
                pairs=np.array(searched, np.int32).reshape(-1, 2),
                apart=np.zeros(len(searched), np.float32),
                reach=reach,
            ),
        )

    def with_self_margin(self, margin: float) -> Self:
        """This robot, whose links keep `margin` (m) from each other in the search, or what `pair_room` allows for a
        pair.
        """
        apart = np.minimum(margin, self.pair_room).astype(np.float32)
        return replace(self, arrays=self.arrays._replace(apart=apart))

    @cached_property
    def continuous(self) -> NDArray[np.bool_]:
        """Which joints (dof,) turn freely."""
        return np.array(self.robot.continuous)

    def range_about(self, q: Array) -> tuple[Array, Array]:
        """Finite limits (dof,) to sample: those of the joints, or for a continuous one half a turn to each side of `q`
        (dof,).
        """
        if not self.continuous.any():
            return self.lower, self.upper
        lower, upper = self.robot.range_about(q.tolist())
        return np.array(lower), np.array(upper)

    @cached_property
    def pair_room(self) -> Array:
        """The distance (n,) in m that each pair of links in `arrays.pairs` can be required to keep, see
        `self_margin.pair_room`.
        """
        q = np.random.default_rng(0).uniform(*self.range_about(np.zeros(self.dof)), (CONFIGURATIONS, self.dof))
        return pair_room(self.bodies, self.link_transforms(q), self.arrays.pairs)

    @cached_property
    def cover(self) -> Cover:
        """Balls around the exact `parts`, whatever the spheres of the descriptor contain."""
        balls = [
            np.concatenate([np.empty((0, 4)), *(sphere_cover(shape, _COVER) for shape in body.shapes)])
            for body in self.bodies
        ]
        placed = [replace(body, balls=own).placed_balls for body, own in zip(self.bodies, balls, strict=True)]
        around = [_bounding_sphere(own) if len(own) else np.zeros(4) for own in placed]
        spread = [
            np.linalg.norm(own[:, :3] - ball[:3], axis=1).max(initial=0.0)
            for own, ball in zip(placed, around, strict=True)
        ]
        return Cover(
            origin=self.arrays.origin,
            revolute=self.arrays.revolute,
            balls=np.concatenate([np.empty((0, 4)), *placed]).astype(np.float32),
            first=np.cumsum([0, *map(len, placed)], dtype=np.int32),
            around=np.column_stack([np.reshape(around, (-1, 4)), spread]).astype(np.float32),
        )

    def fk_tip(self, q: ArrayLike) -> Array:
        """The pose of `tip_link` (..., 4, 4) for joints (..., dof)."""
        return self._frames(q, *self._tip)[..., 0, :, :]

    def fk_joint(self, joint: int, q: ArrayLike) -> Array:
        """The frame (..., 4, 4) that a joint moves for joints (..., dof); -1 is the base."""
        return self._frames(q, np.array([joint], np.int32), np.eye(4)[None])[..., 0, :, :]

    def tip_jacobian(self, q: ArrayLike) -> Array:
        """The tip Jacobian (6, dof) at `q` (dof,): m/rad and rad/rad (m/m and 0 if prismatic), base frame."""
        out = np.empty((1, self.dof + 1, 4, 4))
        joint, offset = self._joints_and_tip
        frames(self.origin, self.revolute, joint, offset, np.array(q, np.float64, ndmin=2), out)
        axes, arms = out[0, :-1, :3, 2], out[0, -1, :3, 3] - out[0, :-1, :3, 3]
        (a, b, c), (x, y, z) = axes.T, arms.T
        turning = (b * z - c * y, c * x - a * z, a * y - b * x, a, b, c)
        sliding = (a, b, c, 0 * a, 0 * b, 0 * c)
        return np.where(self.revolute, turning, sliding)

    @cached_property
    def _joints_and_tip(self) -> tuple[NDArray[np.int32], Array]:
        """The frames of all joints and of the tip, as `kernels.kinematics.frames` takes them."""
        joint = np.append(np.arange(self.dof), self.dof - 1).astype(np.int32)
        return joint, np.append(np.repeat(np.eye(4)[None], self.dof, axis=0), self.offset[-1:], axis=0)

    def link_transforms(self, q: ArrayLike) -> Array:
        """The poses (..., len(links), 4, 4) of `links` for joints (..., dof)."""
        return self._frames(q, self.link_joint, self.offset[:-1])

    @cached_property
    def _tip(self) -> tuple[NDArray[np.int32], Array]:
        """The frame of the tip, as `kernels.kinematics.frames` takes it."""
        return np.array([self.dof - 1], np.int32), self.offset[-1:]

    def _frames(self, q: ArrayLike, joint: NDArray[np.int32], offset: Array) -> Array:
        joints = np.array(q, np.float64, order="C")
        if joints.shape[-1:] != (self.dof,):
            raise InvalidRequest(f"a joint vector of {self.robot.descriptor.name} has {self.dof} values")
        flat = joints.reshape(-1, self.dof)
        out = np.empty((len(flat), len(joint), 4, 4))
        frames(self.origin, self.revolute, joint, offset, flat, out)
        return out.reshape(*joints.shape[:-1], len(joint), 4, 4)


def _bounding_sphere(balls: Array) -> Array:
    """A small sphere (4,) around spheres (n, 4): the centre moves towards the farthest one in decreasing steps.

    Badoiu and Clarkson, "Smaller core-sets for balls", 2003.
    """
    center = balls[:, :3].mean(axis=0)
    for step in range(1, 200):
        away = balls[:, :3] - center
        farthest = int(np.argmax(np.linalg.norm(away, axis=1) + balls[:, 3]))
        center = center + away[farthest] / (step + 1)
    radius = float(np.max(np.linalg.norm(balls[:, :3] - center, axis=1) + balls[:, 3]))
    return np.array([*center, radius])


def _reach(
    origin: Array, revolute: NDArray[np.bool_], extent: Array, link_joint: NDArray[np.int32], spheres: list[Array]
) -> NDArray[np.float32]:
    """`RobotArrays.reach`: a bound for every configuration, as if the arm in between could always be fully stretched."""
    of_spheres = [np.zeros((len(origin), len(balls))) for balls in spheres]
    for reach, carrier, balls in zip(of_spheres, link_joint.tolist(), spheres, strict=True):
        for joint in range(carrier + 1):
            if not revolute[joint]:
                reach[joint] = 1.0
            elif joint == carrier:
                reach[joint] = np.hypot(balls[:, 0], balls[:, 1])
            else:
                # Along the joint's own axis nothing moves, so of the first stretch only x and y count.
                first = math.hypot(origin[joint + 1, 0, 3], origin[joint + 1, 1, 3])
                rest = np.linalg.norm(origin[joint + 2 : carrier + 1, :, 3], axis=1).sum()
                slides = extent[joint + 1 : carrier + 1][~revolute[joint + 1 : carrier + 1]].sum()
                reach[joint] = first + rest + slides + np.linalg.norm(balls[:, :3], axis=1)
    of_links = [reach.max(axis=1, keepdims=True) for reach in of_spheres]
    table = np.hstack((np.empty((len(origin), 0)), *of_links, *of_spheres))
    return np.pad(table, ((0, 0), (0, -table.shape[1] % LANES))).astype(np.float32)


def _weight(reach: NDArray[np.float32]) -> NDArray[np.float32]:
    """The weight (dof,) of each joint in the distances of a search, with a mean square of 1.

    The root of what it can move: on MotionBenchMaker's problems, searches are 10 % faster than with equal weights, and
    as fast as with the reach itself. 0.02 m ensure that a joint that moves nothing still has a cost.
    """
    weight = np.sqrt(reach.max(axis=1, initial=0.0) + 0.02)
    return np.asarray(weight / np.sqrt(np.mean(weight**2)), np.float32)
