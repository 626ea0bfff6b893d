"""Finds a home configuration: collision-free, far from joint limits and singularities, upright."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from zarm_contract.errors import InvalidRequest
from zarm_geometry.collision import is_free
from zarm_geometry.exact import ExactScene
from zarm_geometry.motion_check import MotionCheck
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_robot_import.contacts import SAMPLES
from zarm_trajectory.arrays import Array

_STEP = 1e-4
_MIN_REACH = 0.001
"""What reaches less far (m) is taken to reach so far."""
_MIN_CLEARANCE = 0.002
"""Least distance (m) between links at home."""


_LOOKED_AT = 200
"""Configurations examined for contacts if none is free."""


_EACH = 12
"""Configurations of each of several arms that are tried together."""


def choose_home(
    model: RobotModel, arms: Sequence[str] = (), stated: tuple[float, ...] | None = None
) -> tuple[float, ...]:
    """What is `stated`, if it is within the ranges and free of self-collision, else the best of random configurations near the middle. Raises InvalidRequest if none is free of self-collision.

    Of several `arms`, which are groups, each is looked at alone, with what it shares with the others in the middle; then the best ones
    together.
    """
    if stated is not None:
        q = np.array(stated)
        if ((q >= model.lower) & (q <= model.upper)).all() and _is_free(model, q):
            return stated
    if not arms:
        return tuple(next(_free(model)).tolist())
    names, middle = model.robot.descriptor.joints, np.clip(0.0, model.lower, model.upper)
    own = [[names.index(joint) for joint in model.robot.group_joints(arm)] for arm in arms]
    best: list[list[Array]] = []
    for arm, joints in zip(arms, own, strict=True):
        others = {joint for each in own if each is not joints for joint in each}
        elsewhere = [body.name for body in model.bodies if others & {*model.ancestors(body.joint)}]
        best.append([*itertools.islice(_free(model.group((arm,), middle, without=elsewhere)), _EACH)])
    for ranks in sorted(itertools.product(*(range(len(found)) for found in best)), key=sum):
        q = middle.copy()
        for joints, found, rank in zip(own, best, ranks, strict=True):
            q[joints] = found[rank]
        if _is_free(model, q):
            return tuple(q.tolist())
    raise InvalidRequest(
        f"in none of {_EACH} configurations of each arm are the arms free of each other and of what carries them; look at where they stand, or "
        "import one alone with --tip"
    )


def _is_free(model: RobotModel, q: Array) -> bool:
    return is_free(model, World((), 0.005), q) and MotionCheck(model).check([0.0], [q], margin=_MIN_CLEARANCE).free


def _free(model: RobotModel) -> Iterator[Array]:
    """Random configurations that are free of self-collision, the best first. Raises InvalidRequest if there are none."""
    rng = np.random.default_rng(2)
    middle = np.clip(0.0, model.lower, model.upper)
    lower, upper = np.maximum(model.lower, middle - np.pi), np.minimum(model.upper, middle + np.pi)
    candidates = np.round(rng.uniform(lower, upper, (SAMPLES, model.dof)), 2)
    candidates = np.clip(candidates, lower, upper)
    best = sorted(zip(_score(model, candidates).tolist(), candidates.tolist(), strict=True), reverse=True)
    empty, exact, any_free = World((), 0.005), MotionCheck(model), False
    for _, q in best:
        if is_free(model, empty, q) and exact.check([0.0], [q], margin=_MIN_CLEARANCE).free:
            any_free = True
            yield np.array(q)
    if any_free:
        return
    nearest = (ExactScene(model, empty).nearest(q) for _, q in best[:_LOOKED_AT])
    touching = Counter(found.pair for found in nearest if found.pair and found.distance < _MIN_CLEARANCE)
    what = "the spheres of two links overlap"
    for (one, other), count in touching.most_common(1):
        what = f"what contains {one} and {other} overlaps in {count / _LOOKED_AT:.0%} of the {_LOOKED_AT} that were looked at"
    raise InvalidRequest(
        f"in none of {SAMPLES} configurations is the robot free of itself; {what}. Look at the scale of their meshes and at the joints "
        "between them; and try --geometry visual or collision, more --spheres, or another --tip"
    )


def _score(model: RobotModel, q: Array) -> Array:
    """A score for configurations (n, dof), the higher the better."""
    lower, upper = model.range_about(np.zeros(model.dof))
    # A continuous joint has the same room everywhere.
    margin = np.where(model.continuous, 0.5, np.minimum(q - lower, upper - q) / (upper - lower))
    tip = model.fk_tip(q)
    columns = []
    for joint in range(model.dof):
        moved = q.copy()
        moved[:, joint] += _STEP
        columns.append(_twist(tip, model.fk_tip(moved)) / _STEP)
    reach = max(float(np.linalg.norm(tip[:, :3, 3], axis=1).max()), _MIN_REACH)
    jacobian = np.stack(columns, axis=2) / np.array([reach, reach, reach, 1, 1, 1])[:, None]
    smallest = np.linalg.svd(jacobian, compute_uv=False)[:, -1]
    # The tip in front of the base and above it, with no joint turned further than necessary.
    above = tip[:, 2, 3] > 0.1 * reach
    ahead = np.abs(np.arctan2(tip[:, 1, 3], tip[:, 0, 3])) < 1.0
    calm = 1.0 / (1.0 + 0.3 * np.linalg.norm(q - np.clip(0.0, model.lower, model.upper), axis=1))
    found: Array = smallest * np.minimum(margin.min(axis=1), 0.2) * calm * (0.1 + above) * (0.5 + ahead)
    return found


def _twist(one: Array, other: Array) -> Array:
    """The small motion (n, 6) between poses: translation, rotation vector."""
    turn = other[:, :3, :3] @ one[:, :3, :3].transpose(0, 2, 1)
    rotation = [turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]]
    return np.column_stack([other[:, :3, 3] - one[:, :3, 3], *(half / 2 for half in rotation)])
