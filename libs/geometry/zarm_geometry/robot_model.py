"""The kinematic tree and collision spheres of the robot, packed into arrays."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Attached, tools_of
from zarm_contract.robot import RobotDescription
from zarm_geometry.allowed_collisions import Pairs, link_bits, partners
from zarm_geometry.body import Body, along, attached_body, bounding_ball, link_body
from zarm_geometry.dynamics import Dynamics, JointDynamics, Weight, weights_of, weights_of_load, weights_of_payloads
from zarm_geometry.inertia import stances, stated_limits
from zarm_geometry.joint_tree import JointTree, Place
from zarm_geometry.kernels.arrays import RobotArrays
from zarm_geometry.kernels.broad_phase import Cover
from zarm_geometry.kernels.kinematics import frames
from zarm_geometry.kernels.simd import LANES
from zarm_geometry.self_margin import CONFIGURATIONS, pair_room
from zarm_geometry.shapes import Shape
from zarm_geometry.sphere_cover import sphere_cover
from zarm_trajectory.arrays import Array, Index

Openings = tuple[tuple[str, float], ...]
"""Grippers of a robot with their openings (m)."""

_COVER = 12
"""Most balls around an exact shape in the broad phase."""


class Whole(NamedTuple):
    """The robot that a group belongs to, and the place of each of its joints among those of the group; of these, the joints `moving` are the
    group's, and the others stand as in `standing` (dof,).
    """

    model: RobotModel
    places: tuple[Place, ...]
    moving: NDArray[np.intp]
    standing: Array


@dataclass(frozen=True)
class RobotModel:
    """One robot in arrays; every joint vector follows the descriptor's `joints`, every pose is in its `base_link`.

    `lower`, `upper` (rad, m for a prismatic joint; infinite for a continuous one), `velocity`, `acceleration` and `jerk` have the shape (dof,).
    `bodies` are all collision bodies, in kinematic order, and `links` their names; `link_joint` (links,) is the moving
    joint that carries each, -1 for the base. `pairs` (n, 2) are the indices of those that can collide with each other:
    all except pairs that may touch, or belong to the same rigid body. `parts` are the exact shapes, each with the index
    of the link in whose frame it is. `tip_joint` is the joint that carries the tip. The model of a group belongs to that
    of the `whole` robot, and one with attached objects, its `loads`, to that `without` them. `allowed` are the pairs of links and objects that may touch.
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
    link_joint: Index
    pairs: Index
    parts: tuple[tuple[int, Shape], ...]
    tree: JointTree
    offset: Array
    weight: NDArray[np.float32]
    arrays: RobotArrays
    tip_joint: int
    whole: Whole | None
    without: RobotModel | None
    loads: tuple[Attached, ...] = ()
    allowed: Pairs = ()

    @classmethod
    def of(cls, robot: RobotDescription) -> Self:
        """Pack a robot without attached objects, its grippers open."""
        grippers = robot.gripper_positions({})
        bodies = [link_body(robot, link, grippers) for link in robot.descriptor.spheres]
        passed, tip = along(robot.urdf.chain(robot.descriptor.base_link, robot.descriptor.tip_link), {})
        return cls._packed(robot, JointTree.of(robot), (robot.descriptor.joints.index(passed[-1][0]), tip), bodies)

    def group(self, names: Sequence[str], q: Array, without: Collection[str] = ()) -> Self:
        """The model of the joints of some groups, with the tip of the first. The other joints stand as in `q` (dof,);
        `without` are links and attached objects that are left out. Raises InvalidRequest.
        """
        robot, joints = self.robot.group(*names), self.robot.descriptor.joints
        moving = [joints.index(joint) for joint in robot.descriptor.joints]
        frames = self._frames(q, np.arange(self.dof, dtype=np.int32), self._at_joints)
        tree, places = self.tree.standing(moving, frames)
        tip = _placed(self.mount(robot.descriptor.tip_link), places)
        bodies = [
            body if body.joint < 0 else body.carried(*places[body.joint])
            for body in self.bodies
            if body.name not in without
        ]
        whole = Whole(self, tuple(places), np.array(moving), q)
        return self._packed(robot, tree, tip, bodies, whole, allowed=self.allowed)

    def with_attached(
        self,
        attached: Sequence[Attached],
        ignored_links: Sequence[str],
        openings: Openings = (),
        allowed: Pairs = (),
    ) -> Self:
        """This robot with one more body for each attached object, without the ignored links, with grippers at these
        `openings`, and with pairs of links and objects that are `allowed` to touch; grippers left out are open.

        The object is named as in the scene; it may touch its `touch_links`. A tool among them has the tip.
        """
        grippers = self.robot.descriptor.grippers
        openings = tuple((name, width) for name, width in openings if width != grippers[name].open)
        if not attached and not ignored_links and not openings and not allowed:
            return self
        bodies = [body for body in self._at(openings) if body.name not in ignored_links]
        bodies += [attached_body(item, *self.mount(self.carrier(item))) for item in attached]
        bodies = [
            replace(body, touches=body.touches | more) if (more := partners(body.name, allowed)) else body
            for body in bodies
        ]
        robot = self.robot.with_tools(tools_of(attached))
        tip = (self.tip_joint, self.offset[-1]) if robot is self.robot else self.mount(robot.descriptor.tip_link)
        return self._packed(robot, self.tree, tip, bodies, without=self, loads=tuple(attached), allowed=allowed)

    def with_tools(self, attached: Sequence[Attached]) -> Self:
        """This robot with only the mounted tools of what is attached."""
        return self.with_attached([one for one in attached if one.tool is not None], ())

    def carrier(self, item: Attached) -> str:
        """The link to which an object is attached."""
        return item.link or (self.without or self).robot.descriptor.tip_link

    def mount(self, link: str) -> Place:
        """The joint that carries a link, -1 for the base, and the link (4, 4) in that joint's frame. Raises
        InvalidRequest for a link that is not of this robot, or is moved by other joints too.
        """
        if link not in self._mounts:
            self._mounts[link] = self._mount(link)
        return self._mounts[link]

    @cached_property
    def _mounts(self) -> dict[str, Place]:
        """By link, once it was asked for."""
        return {}

    def _mount(self, link: str) -> Place:
        if self.whole is not None:
            return _placed(self.whole.model.mount(link), self.whole.places)
        descriptor = self.robot.descriptor
        chain = self.robot.urdf.chain(descriptor.base_link, link)
        for joint in chain:
            if joint.type != "fixed" and joint.name not in descriptor.joints:
                raise InvalidRequest(f"{link} hangs on {joint.name}, which is not a joint of the robot")
        passed, pose = along(chain, {})
        return descriptor.joints.index(passed[-1][0]) if passed else -1, pose

    def ancestors(self, joint: int) -> list[int]:
        """A joint and those that carry it, inwards; none for the base (-1)."""
        return self.tree.ancestors(joint)

    @property
    def parent(self) -> Index:
        """The joint that carries each joint (dof,), an earlier one or -1 for the base."""
        return self.tree.parent

    @property
    def origin(self) -> Array:
        """Each joint's frame (dof, 3, 4) in its parent's at 0, with the axis along z."""
        return self.tree.origin

    @property
    def revolute(self) -> NDArray[np.bool_]:
        """Which joints (dof,) turn; the others slide."""
        return self.tree.revolute

    @cached_property
    def stretch(self) -> list[float]:
        """How far (m) each joint's frame can be from that of its parent."""
        slide = np.where(self.revolute, 0.0, np.maximum(abs(self.lower), abs(self.upper)))
        return list((np.linalg.norm(self.origin[:, :, 3], axis=1) + slide).tolist())

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
    def _packed(
        cls,
        robot: RobotDescription,
        tree: JointTree,
        tip: Place,
        bodies: Sequence[Body],
        whole: Whole | None = None,
        without: RobotModel | None = None,
        loads: tuple[Attached, ...] = (),
        allowed: Pairs = (),
    ) -> Self:
        """The model of a robot with these bodies."""
        descriptor = robot.descriptor
        # In kinematic order, so that kernels finish the links of one joint before they go on to the next.
        bodies = sorted(bodies, key=lambda body: body.joint)
        link_joint = np.array([body.joint for body in bodies], np.int32)
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
        reach = _reach(tree, np.maximum(abs(lower), abs(upper)), link_joint, spheres)
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
            tree=tree,
            offset=np.array([*(body.pose for body in bodies), tip[1]]),
            weight=_weight(reach),
            arrays=RobotArrays(
                tree=tree.table,
                origin=tree.origin.astype(np.float32),
                link_joint=link_joint,
                link_first=np.cumsum([0, *(len(balls) for balls in spheres)], dtype=np.int32),
                spheres=np.concatenate([np.empty((0, 4)), *spheres]).astype(np.float32),
                bounds=np.array([body.placed_around for body in bodies], np.float32).reshape(-1, 4),
                pairs=np.array(searched, np.int32).reshape(-1, 2),
                common=tree.common(link_joint, np.array(searched, np.int32).reshape(-1, 2)),
                apart=np.zeros(len(searched), np.float32),
                reach=reach,
                bit=link_bits([body.name for body in bodies], allowed),
            ),
            tip_joint=tip[0],
            whole=whole,
            without=without,
            loads=loads,
            allowed=allowed,
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
        names = self._searched_pairs
        known = self._known_room()
        missing = [k for k, name in enumerate(names) if name not in known]
        if missing:
            q = np.random.default_rng(0).uniform(*self.range_about(np.zeros(self.dof)), (CONFIGURATIONS, self.dof))
            measured = pair_room(self.bodies, self.link_transforms(q), self.arrays.pairs[missing])
            known |= dict(zip((names[k] for k in missing), measured.tolist(), strict=True))
        return np.array([known[name] for name in names])

    def _known_room(self) -> dict[frozenset[str], float]:
        """`pair_room` of the pairs of which it is known: for a group as in the whole robot, whose other joints move too, and with what is
        attached as without it.
        """
        model = self.without if self.whole is None else self.whole.model
        if model is None:
            return {}
        known = dict(zip(model._searched_pairs, model.pair_room.tolist(), strict=True))
        if self.whole is not None:
            return known
        return {pair: room for pair, room in known.items() if pair <= self._unchanged}

    @property
    def _unchanged(self) -> set[str]:
        """The bodies that are as they are `without` what is attached."""
        there = {id(body) for body in self.without.bodies} if self.without is not None else set()
        return {body.name for body in self.bodies if id(body) in there}

    @cached_property
    def _searched_pairs(self) -> list[frozenset[str]]:
        """The names of the links of `arrays.pairs`."""
        return [frozenset((self.links[i], self.links[j])) for i, j in self.arrays.pairs.tolist()]

    @cached_property
    def _covers(self) -> dict[str, tuple[Array, Array]]:
        """For each body, bounding spheres of its exact shapes and one sphere around these, in the frame of the body."""
        if self.whole is not None:
            return self.whole.model._covers
        covers = {}
        if self.without is not None:
            same = self._unchanged
            covers = {name: cover for name, cover in self.without._covers.items() if name in same}
        for body in self.bodies:
            if body.name in covers:
                continue
            balls = np.concatenate([np.empty((0, 4)), *(sphere_cover(shape, _COVER) for shape in body.shapes)])
            covers[body.name] = balls, bounding_ball(balls) if len(balls) else np.zeros(4)
        return covers

    @cached_property
    def cover(self) -> Cover:
        """Balls around the exact `parts`, whatever the spheres of the descriptor contain."""
        covered = [
            replace(body, balls=balls, around=around)
            for body in self.bodies
            for balls, around in (self._covers[body.name],)
        ]
        placed = [body.placed_balls for body in covered]
        around = [body.placed_around for body in covered]
        spread = [
            np.linalg.norm(own[:, :3] - ball[:3], axis=1).max(initial=0.0)
            for own, ball in zip(placed, around, strict=True)
        ]
        return Cover(
            tree=self.tree.table,
            origin=self.arrays.origin,
            link_joint=self.link_joint,
            balls=np.concatenate([np.empty((0, 4)), *placed]).astype(np.float32),
            first=np.cumsum([0, *map(len, placed)], dtype=np.int32),
            around=np.column_stack([np.reshape(around, (-1, 4)), spread]).astype(np.float32),
        )

    def fk_tip(self, q: ArrayLike, group: str | None = None) -> Array:
        """The pose of the `tip_link`, or of the tip of a group, (..., 4, 4) for joints (..., dof)."""
        joint, offset, _ = self._tips[group]
        return self._frames(q, np.array([joint], np.int32), offset[None])[..., 0, :, :]

    def tip_place(self, group: str | None) -> Place:
        """The joint that carries the tip of a group, or the `tip_link`, -1 for the base, and the tip (4, 4) in its frame."""
        if group is None:
            return self.tip_joint, self.offset[-1]
        return self.mount(self.robot.tip_of((group,)))

    def fk_link(self, link: str, q: ArrayLike) -> Array:
        """The pose of a link (..., 4, 4) for joints (..., dof). Raises InvalidRequest for one that is not of this robot."""
        return self.fk_frame(self.mount(link), q)

    def fk_joint(self, joint: int, q: ArrayLike) -> Array:
        """The frame (..., 4, 4) that a joint moves for joints (..., dof); -1 is the base."""
        return self.fk_frame((joint, np.eye(4)), q)

    def fk_frame(self, place: Place, q: ArrayLike) -> Array:
        """The pose (..., 4, 4) of a frame in that of a joint, see `mount`, for joints (..., dof)."""
        joint, offset = place
        return self._frames(q, np.array([joint], np.int32), offset[None])[..., 0, :, :]

    def tip_jacobian(self, q: ArrayLike, group: str | None = None) -> Array:
        """The Jacobian (6, dof) of the tip, or of the tip of a group, at `q` (dof,): m/rad and rad/rad (m/m and 0 if prismatic), base
        frame. For a group, joints that are not of it have columns of zeros.
        """
        out = np.empty((1, self.dof + 1, 4, 4))
        tip_joint, tip, moves = self._tips[group]
        joint = np.append(np.arange(self.dof), tip_joint).astype(np.int32)
        offset = np.append(self._at_joints, tip[None], axis=0)
        frames(self.tree.table, self.origin, joint, offset, np.array(q, np.float64, ndmin=2), out)
        axes, arms = out[0, :-1, :3, 2], out[0, -1, :3, 3] - out[0, :-1, :3, 3]
        (a, b, c), (x, y, z) = axes.T, arms.T
        turning = (b * z - c * y, c * x - a * z, a * y - b * x, a, b, c)
        sliding = (a, b, c, 0 * a, 0 * b, 0 * c)
        return np.where(moves, np.where(self.revolute, turning, sliding), 0.0)

    @cached_property
    def dynamics(self) -> Dynamics | None:
        """What the robot and its loads weigh, and the largest torques, for a group those of all joints; None if its URDF does not state the inertia of each
        link. A load without a mass weighs nothing.
        """
        if self.whole is not None:
            whole = self.whole.model.dynamics
            return None if whole is None else whole.of_group(self.whole.moving, self.whole.standing)
        weights = self._weights
        stated = self.robot.descriptor.execution.joint_dynamics
        joints = None if stated is None else JointDynamics.of(stated)
        return None if weights is None else Dynamics.of(self.tree, weights, self._torque_limits, joints)

    @cached_property
    def _weights(self) -> tuple[Weight, ...] | None:
        links = self._own_weights if self.without is None else self.without._weights
        if links is None:
            return None
        loads = (
            weight
            for item in self.loads
            if item.mass is not None
            for weight in weights_of_load(item, item.mass, self.mount(self.carrier(item)))
        )
        return (*links, *loads)

    @cached_property
    def _own_weights(self) -> tuple[Weight, ...] | None:
        links = weights_of(self.robot)
        return None if links is None else (*links, *weights_of_payloads(self.robot))

    @cached_property
    def _torque_limits(self) -> Array:
        if self.without is not None:
            return self.without._torque_limits
        unlimited = Dynamics.of(self.tree, weights_of(self.robot) or (), np.full(self.dof, np.inf))
        return stated_limits(self.robot, unlimited.holding(stances(self.robot)))

    @cached_property
    def _at_joints(self) -> Array:
        return np.repeat(np.eye(4)[None], self.dof, axis=0)

    @cached_property
    def _tips(self) -> dict[str | None, tuple[int, Array, NDArray[np.bool_]]]:
        """By group, and for None of the `tip_link`: the joint that carries the tip, the tip (4, 4) in its frame, and which joints (dof,)
        move it.
        """
        joints = self.robot.descriptor.joints
        moves = np.isin(np.arange(self.dof), self.ancestors(self.tip_joint))
        tips: dict[str | None, tuple[int, Array, NDArray[np.bool_]]] = {None: (self.tip_joint, self.offset[-1], moves)}
        for name, group in self.robot.descriptor.groups.items():
            if group.tip_link is not None:
                own = np.isin(joints, self.robot.group_joints(name))
                tips[name] = (*self.mount(group.tip_link), own)
        return tips

    def link_transforms(self, q: ArrayLike) -> Array:
        """The poses (..., len(links), 4, 4) of `links` for joints (..., dof)."""
        return self._frames(q, self.link_joint, self.offset[:-1])

    def _frames(self, q: ArrayLike, joint: Index, offset: Array) -> Array:
        joints = np.array(q, np.float64, order="C")
        if joints.shape[-1:] != (self.dof,):
            raise InvalidRequest(f"a joint vector of {self.robot.descriptor.name} has {self.dof} values")
        flat = joints.reshape(-1, self.dof)
        out = np.empty((len(flat), len(joint), 4, 4))
        frames(self.tree.table, self.origin, joint, np.ascontiguousarray(offset), flat, out)
        return out.reshape(*joints.shape[:-1], len(joint), 4, 4)


def _placed(place: Place, places: Sequence[Place]) -> Place:
    """A place on one of the whole robot's joints as one on those of a group."""
    if place[0] < 0:
        return place
    joint, frame = places[place[0]]
    return joint, frame @ place[1]


def _reach(tree: JointTree, extent: Array, link_joint: Index, spheres: list[Array]) -> NDArray[np.float32]:
    """`RobotArrays.reach`: a bound for every configuration, as if the arm in between could always be fully stretched."""
    origin, revolute = tree.origin, tree.revolute
    of_spheres = [np.zeros((len(origin), len(balls))) for balls in spheres]
    for reach, carrier, balls in zip(of_spheres, link_joint.tolist(), spheres, strict=True):
        further: list[int] = []  # the joints between this one and the carrier, and the carrier itself
        for joint in tree.ancestors(carrier):
            if not revolute[joint]:
                reach[joint] = 1.0
            elif not further:
                reach[joint] = np.hypot(balls[:, 0], balls[:, 1])
            else:
                # Along the joint's own axis nothing moves, so of the first stretch only x and y count.
                first = math.hypot(origin[further[-1], 0, 3], origin[further[-1], 1, 3])
                rest = np.linalg.norm(origin[further[:-1], :, 3], axis=1).sum()
                slides = extent[further][~revolute[further]].sum()
                reach[joint] = first + rest + slides + np.linalg.norm(balls[:, :3], axis=1)
            further.append(joint)
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
