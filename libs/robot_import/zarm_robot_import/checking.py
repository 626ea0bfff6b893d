"""Mistakes in a descriptor that no schema finds: units, covers, links that do not meet, a robot that cannot move."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from zarm_contract.robot import RobotDescription
from zarm_geometry.collision import is_free
from zarm_geometry.exact import ExactScene
from zarm_geometry.packed_shapes import bounds
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.shapes import distance
from zarm_geometry.world import World
from zarm_robot_import.kernels.balls import around_shapes
from zarm_robot_import.limits import WIDEST
from zarm_robot_import.primitives import packed_shapes_of
from zarm_robot_import.source import read_source
from zarm_robot_import.spheres import protrusion
from zarm_trajectory.arrays import Array

SAMPLES = 1000
"""Random configurations; a condition true in more than 0.5 % of all is found with 99 % confidence."""
LARGEST, SMALLEST = 6.0, 0.05
"""No arm reaches further, or less far (m); otherwise lengths are most likely in another unit."""
OUTSIDE = 0.004
"""Exact geometry outside its spheres by more than this (m) is reported; the proof itself may be off by 3 mm."""
_FINEST = 0.0005
PROTRUDES = 0.06
"""A sphere may protrude from its link by this (m), however small the link is, ..."""
_FILLED_SHARE, _OUTSIDE_SHARE = 0.35, 0.2
"""... and from a large link by this share of its length; the second one if its centre is most likely outside the link."""
_CENTRE_OUTSIDE = 0.9
"""A sphere that protrudes by more than this share of its radius most likely has its centre outside the link."""
MAX_NEIGHBOUR_DISTANCE = 0.1
"""Neighbouring links that are never closer than this (m) most likely have a wrong frame, axis or unit."""
RARELY = 0.02
"""If a smaller share of all configurations is free, something is nearly always in contact."""


_USUAL = {"velocity": (0.005, 50.0), "acceleration": (0.02, 500.0), "jerk": (0.2, 1e5)}
"""Limits of arms (rad or m, and s): those of twenty makers are ten times inside."""
_BEYOND, _BEYOND_FAR = 1.5, 4.0
"""An acceleration, and a velocity, that exceeds what can be reached by this factor is most likely a mistake, or another limit is;
beside an acceleration that is assumed with care, the fastest arms have twice the velocity that can be reached.
"""


def findings(robot: RobotDescription) -> list[str]:
    """What is most likely wrong, one sentence each with the key to look at and the remedy; empty if all seems well."""
    model = RobotModel.of(robot)
    q = np.random.default_rng(0).uniform(*model.range_about(np.zeros(model.dof)), (SAMPLES, model.dof))
    return [
        *_size(model, q),
        *_joints(model),
        *_rates(model),
        *_meshes(robot),
        *_covers(robot),
        *_neighbours(model, q),
        *_contacts(model, q),
    ]


def _size(model: RobotModel, q: Array) -> Iterator[str]:
    origins = [joint.xyz for joint in model.robot.urdf.joint_of_child.values()]
    tips = model.fk_tip(q)[:, :3, 3]
    reach = float(np.linalg.norm(tips, axis=1).max())
    longest = float(np.linalg.norm(np.array(origins).reshape(-1, 3), axis=1).max(initial=0.0))
    if longest > LARGEST:
        yield f"urdf: an origin is {longest:g} m from its parent; it is most likely in mm: divide every xyz by 1000"
    elif not SMALLEST < reach < LARGEST:
        yield f"urdf: the tip reaches {reach:.3g} m; lengths are in m: look at every xyz, and at tip_link"
    elif (room := float(np.ptp(tips, axis=0).max())) < SMALLEST:
        yield f"urdf: over all joint ranges the tip moves by {1e3 * room:.0f} mm; look at the limits, and at tip_link"
    largest = max(float(body.placed_balls[:, 3].max()) for body in model.bodies)
    if largest > max(reach, SMALLEST):
        yield f"spheres: a radius of {largest:g} m is more than the robot reaches ({reach:.3g} m); lengths are in m"


def _joints(model: RobotModel) -> Iterator[str]:
    descriptor = model.robot.descriptor
    home = np.array(descriptor.home)
    still = _tips(model, home)
    for index, joint in enumerate(descriptor.joints):
        width = model.upper[index] - model.lower[index]
        if width < 1e-3:
            yield f"{joint}: its range is {width:g} wide in the URDF; make the joint fixed, or correct lower and upper"
        elif width > WIDEST and not model.continuous[index]:
            yield f"{joint}: its range is {width:g} rad wide in the URDF, most likely degrees; write lower and upper in rad"
        elif not model.continuous[index] and (
            min(home[index] - model.lower[index], model.upper[index] - home[index]) < 0.02 * width
        ):
            yield f"home: {joint} stands at its limit; choose a pose from which it can turn both ways"
        moved = home.copy()
        moved[index] += 0.1 if home[index] < model.upper[index] - 0.1 else -0.1
        if np.allclose(_tips(model, moved), still, atol=1e-9):
            yield f"tip_link: {joint} does not move {' or '.join(model.robot.tips)}; check its axis in the URDF"


def _tips(model: RobotModel, q: Array) -> Array:
    """The poses (tips, 4, 4) of the tips of all groups."""
    return np.array([model.fk_link(tip, q) for tip in model.robot.tips])


def _rates(model: RobotModel) -> Iterator[str]:
    """Limits that no arm has, and limits that no motion can reach under the others."""
    cspace = model.robot.descriptor.cspace
    ways = np.minimum(model.upper - model.lower, 2 * np.pi)
    for k, joint in enumerate(model.robot.descriptor.joints):
        values = (cspace.velocity[k], cspace.acceleration[k], cspace.jerk[k])
        unlikely = False
        for name, value, (least, most), unit in zip(_USUAL, values, _USUAL.values(), ("/s", "/s²", "/s³"), strict=True):
            if not least <= value <= most:
                unlikely = True
                yield (
                    f"cspace.{name}[{k}]: {joint} with {value:g} rad{unit} is unlikely: arms have {least:g} to {most:g}; look it up in the "
                    "data sheet, and at its unit"
                )
        if unlikely:
            continue
        velocity, acceleration, jerk = values
        # Rest to rest over the range: with jerk j the acceleration peaks at (d j^2 / 2)^(1/3), and on the way to a velocity v at
        # sqrt(v j); with acceleration a the velocity peaks at sqrt(a d).
        reached = min(float(ways[k] * jerk**2 / 2) ** (1 / 3), (velocity * jerk) ** 0.5)
        if acceleration > _BEYOND * reached:
            yield (
                f"cspace.acceleration[{k}]: {joint} cannot reach {acceleration:g} rad/s²: with a jerk of {jerk:g} rad/s³ no motion uses more "
                f"than {reached:.2g}; correct the one that is wrong"
            )
        reached = float(min(acceleration, reached) * ways[k]) ** 0.5
        if velocity > _BEYOND_FAR * reached:
            yield (
                f"cspace.velocity[{k}]: {joint} cannot reach {velocity:g} rad/s: within its range, with an acceleration of {acceleration:g} "
                f"rad/s² and a jerk of {jerk:g} rad/s³, no motion is faster than {reached:.2g}; correct the one that is wrong"
            )


def _meshes(robot: RobotDescription) -> Iterator[str]:
    source = read_source(robot.urdf_path)
    for element in source.root.iter("mesh"):
        if source.file(name := element.get("filename", "")) is None:
            yield f"{source.place(element)}: there is no mesh {name}, so nobody sees it on the page; correct the path, or import again"


def _covers(robot: RobotDescription) -> Iterator[str]:
    for link, primitives in robot.descriptor.collision.items():
        rows = packed_shapes_of(primitives)
        balls = np.array([(*ball.center, ball.radius) for ball in robot.descriptor.spheres[link]])
        lacking = float((around_shapes(balls, rows, _FINEST)[:, 3] - balls[:, 3]).max())
        if lacking > OUTSIDE:
            yield (
                f"spheres.{link}: its exact geometry stands out of its spheres, by up to {1e3 * lacking:.0f} mm; the search would "
                "take what is verified as a collision afterwards: enlarge the spheres or add some"
            )
        out = [protrusion(ball, rows) for ball in balls]
        lower, upper = bounds(rows)
        length = float(np.linalg.norm(upper.max(axis=0) - lower.min(axis=0)))
        allowed = [
            max(PROTRUDES, length * (_OUTSIDE_SHARE if far > _CENTRE_OUTSIDE * ball[3] else _FILLED_SHARE))
            for far, ball in zip(out, balls, strict=True)
        ]
        index = int(np.argmax(np.subtract(out, allowed)))
        if out[index] > allowed[index]:
            yield (
                f"spheres.{link}[{index}]: it stands out of the link by {1e3 * out[index]:.0f} mm and takes free space; look at its "
                "center and radius"
            )


def _neighbours(model: RobotModel, q: Array) -> Iterator[str]:
    few = model.link_transforms(q[:50])
    by_joint = {
        joint: [(link, shape) for link, shape in model.parts if model.link_joint[link] == joint]
        for joint in sorted(set(model.link_joint.tolist()))
    }
    for other, carried in by_joint.items():
        one = int(model.parent[other]) if other >= 0 else -1
        carrier = by_joint.get(one, [])
        if other < 0 or not carrier:
            continue
        nearest = min(
            distance(a, poses[i] @ a.pose, b, poses[j] @ b.pose)
            for poses in few
            for i, a in carrier
            for j, b in carried
        )
        if nearest > MAX_NEIGHBOUR_DISTANCE:
            names = [model.links[parts[0][0]] for parts in (carrier, carried)]
            yield (
                f"collision.{names[1]}: it never comes nearer than {1e3 * nearest:.0f} mm to {names[0]}, which carries it; look at the "
                "origin and axis of the joint between them, and at the units of both"
            )


def _contacts(model: RobotModel, q: Array) -> Iterator[str]:
    empty, exact = World((), 0.0), ExactScene(model, World((), 0.0))
    home = np.array(model.robot.descriptor.home)
    nearest = exact.nearest(home)
    if nearest.pair is not None and nearest.distance <= 0.0:
        yield f"home: {' and '.join(nearest.pair)} are in contact there; choose another pose, or ignore the pair"
    elif not is_free(model, empty, home):
        yield "home: spheres of two links overlap there; the search could not start: shrink them, or choose another pose"
    free = float(np.mean([is_free(model, empty, each) for each in q]))
    if free < RARELY:
        yield (
            f"spheres: {free:.1%} of all configurations are free of self-collision; look which pair always touches, and put it into "
            "self_collision_ignore if it may"
        )
