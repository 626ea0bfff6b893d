"""Batches of forward and inverse kinematics, on the device that a request asks for.

Kernels solve one pose after the other; pytorch-kinematics solves all of them in lockstep, which pays on a GPU. torch is
loaded by the first request that needs it: it takes 2 s and 250 MB.
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Device
from zarm_geometry.collision import is_free
from zarm_geometry.exact import ExactScene
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.deadline import Deadline
from zarm_planner.kernels.inverse import DISTINCT, TOLERANCE, TURN
from zarm_planner.kinematics.ik import solve_ik, with_turns
from zarm_planner.kinematics.pose_region import PoseRegion
from zarm_trajectory.arrays import Array

if TYPE_CHECKING:
    from pytorch_kinematics import SerialChain


WORTH_A_GPU = 10_000
"""Number of requested solutions from which `auto` uses a GPU for inverse kinematics.

Kernels need 25 to 60 us for each, so 0.25 to 0.6 s for this many. In lockstep, a batch of any size takes up to 4 rounds
of 20 steps with some 70 small GPU kernels of 5 to 10 us each, 30 to 60 ms, plus choosing the nearest, some 15 us per
solution. An estimate from CPU times; not measured on a GPU.
"""
_CHOICE = 64
"""Solutions of a pose among which those that are free in exact geometry are chosen, once spheres have missed a collision.
"""
_CONVERGED = 1e-7
"""m and rad. pytorch-kinematics reads a URDF in float32, which may move the tip by as much again; TOLERANCE allows
both.
"""
_STARTS = 4
"""Starts per requested solution in each round; in the first round `near` is among them."""
_ROUNDS = 4
_ITERATIONS = 20
"""Nine of ten descents that end at a pose do so within 13 steps."""
_ROWS = {"cpu": 4096, "cuda": 65536}
"""Descents in one lockstep batch, after which a deadline or a cancel is noticed; they take some 50 and 800 MB."""


def batch_fk(model: RobotModel, joints: Array, device: Device) -> Array:
    """The poses (n, 4, 4) of the tip in the base frame for joints (n, dof). Raises InvalidRequest for the device.

    `auto` means kernels: they need 0.3 us per pose, less than starting a GPU computation.
    """
    if device in ("auto", "kernels"):
        return model.fk_tip(joints)
    _require(device)
    import torch

    chain = _chain(model, device)
    with torch.no_grad():
        poses: Array = chain.forward_kinematics(torch.as_tensor(joints, device=device)).get_matrix().cpu().numpy()
    return poses


def batch_ik(
    model: RobotModel,
    poses: Array,
    near: Array,
    *,
    world: World | None,
    max_solutions: int,
    seed: int,
    device: Device,
    deadline: Deadline,
    exact: ExactScene | None = None,
) -> list[Array]:
    """For each pose (n, 4, 4) of the tip the solutions (m, dof) that `ik.solve_ik` promises, on any device; those that
    are free in `exact` geometry too, if it is given.

    Solutions from torch are checked with the kernels' own forward kinematics; poses without a solution there are solved
    by kernels. Raises InvalidRequest for the device, and the deadline's error.
    """
    if device == "auto":
        device = "cuda" if len(poses) * max_solutions >= WORTH_A_GPU and _has_gpu() else "kernels"
    solutions = [np.empty((0, model.dof))] * len(poses)
    if device != "kernels":
        _require(device)
        together = max(1, _ROWS[device] // (_STARTS * max_solutions))
        for first in range(0, len(poses), together):
            some = slice(first, first + together)
            solutions[some] = _in_step(model, poses[some], near, world, max_solutions, seed, device, deadline)
    for i, pose in enumerate(poses):
        if not len(solutions[i]):
            solutions[i] = solve_ik(
                model, pose, near, world=world, max_solutions=max_solutions, seed=seed, deadline=deadline
            ).solutions
            deadline.check()
        if exact is not None and not exact.is_free(solutions[i], deadline.check):
            more = solve_ik(
                model, pose, near, world=world, max_solutions=_CHOICE, seed=seed, deadline=deadline
            ).solutions
            solutions[i] = _free_of(more, exact, max_solutions, deadline)
    return solutions


def batch_regions(
    regions: Sequence[PoseRegion],
    near: Array,
    *,
    world: World | None,
    max_solutions: int,
    seed: int,
    device: Device,
    deadline: Deadline,
    exact: ExactScene | None = None,
) -> list[Array]:
    """For each region of poses the solutions (m, dof) that `PoseRegion.solve` promises; those that are free in `exact`
    geometry too, if it is given.

    Raises InvalidRequest for a device without kernels, and the deadline's error.
    """
    if device not in ("auto", "kernels"):
        raise InvalidRequest(
            f"poses with a tolerance or another tip are not computed on the device {device}; ask for auto or kernels",
            field="device",
        )
    solutions = []
    for region in regions:
        found, _ = region.solve(near, world=world, max_solutions=max_solutions, seed=seed, deadline=deadline)
        rows = found.solutions
        deadline.check()
        if exact is not None and not exact.is_free(rows, deadline.check):
            found, _ = region.solve(near, world=world, max_solutions=_CHOICE, seed=seed, deadline=deadline)
            rows = _free_of(found.solutions, exact, max_solutions, deadline)
        solutions.append(rows)
    return solutions


def _free_of(rows: Array, exact: ExactScene, most: int, deadline: Deadline) -> Array:
    """The first `most` of the configurations (n, dof) that are free in exact geometry."""
    free = [q for q in rows if exact.is_free(q, deadline.check)]
    return np.array(free[:most]).reshape(-1, rows.shape[1])


def _in_step(
    model: RobotModel,
    poses: Array,
    near: Array,
    world: World | None,
    max_solutions: int,
    seed: int,
    device: Device,
    deadline: Deadline,
) -> list[Array]:
    """Solutions of poses from a few rounds of descents; poses with enough solutions are left out of the next round."""
    import pytorch_kinematics as pk
    import torch

    chain, random = _chain(model, device), np.random.default_rng(seed)
    found = [np.empty((0, model.dof))] * len(poses)
    solutions = list(found)
    for _ in range(_ROUNDS):
        lacking = [i for i, rows in enumerate(solutions) if len(rows) < max_solutions]
        if not lacking:
            break
        deadline.check()
        starts = random.uniform(*model.range_about(near), (_STARTS * max_solutions, model.dof))
        if len(lacking) == len(poses):
            starts[0] = np.clip(near, model.lower, model.upper)
        solver = pk.PseudoInverseIK(
            chain,
            retry_configs=torch.as_tensor(starts, device=device),
            pos_tolerance=_CONVERGED,
            rot_tolerance=_CONVERGED,
            max_iterations=_ITERATIONS,
            clamp_to_limits=True,
            enforce_joint_limits=False,  # would wrap to the middle of the range, but solutions near `near` are wanted
        )
        ended = solver.solve(pk.Transform3d(matrix=torch.as_tensor(poses[lacking], device=device)))
        ends, converged = ended.solutions.cpu().numpy(), ended.converged.cpu().numpy()
        rows, reached = _accepted(model, poses[lacking], near, ends)
        for i, mine, good in zip(lacking, rows, reached & converged, strict=True):
            found[i] = np.vstack((found[i], mine[good]))
            solutions[i] = _nearest_free(model, found[i], near, world, max_solutions)
    return solutions


def _accepted(model: RobotModel, poses: Array, near: Array, rows: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Joints (n, starts, dof) in the limits and turned towards `near`; and whether they reach their poses by the
    kernels' check.
    """
    # pytorch-kinematics clamps to limits in float32 and ignores `near`; full turns do not change the pose.
    rows = np.clip(rows, model.lower, model.upper)
    least, most = np.ceil((model.lower - rows) / TURN), np.floor((model.upper - rows) / TURN)
    rows = rows + np.where(model.revolute, TURN * np.clip(np.round((near - rows) / TURN), least, most), 0.0)
    off = model.fk_tip(rows) - poses[:, None]
    distance = np.linalg.norm(off[..., :3, 3], axis=-1)
    # The difference of two rotations that are an angle t apart has the Frobenius norm 2 sqrt(2) sin(t / 2).
    angle = 2.0 * np.arcsin(np.minimum(1.0, np.linalg.norm(off[..., :3, :3], axis=(-2, -1)) / math.sqrt(8.0)))
    return rows, (distance <= TOLERANCE) & (angle <= TOLERANCE)


def _nearest_free(model: RobotModel, rows: Array, near: Array, world: World | None, most: int) -> Array:
    """At most `most` distinct rows, free in the world, the nearest first."""
    kept: list[Array] = []
    for row in rows[np.argsort(((rows - near) ** 2).sum(axis=1), kind="stable")]:
        if len(kept) == most:
            break
        if (not kept or np.abs(row - kept).max(axis=1).min() >= DISTINCT) and (
            world is None or is_free(model, world, row)
        ):
            kept.append(row)
    return with_turns(model, np.array(kept).reshape(-1, model.dof), near, most)


def _require(device: Device) -> None:
    """Raises InvalidRequest if a device that needs torch is not available."""
    if not _has_torch():
        raise InvalidRequest(
            f"the device {device} needs torch and pytorch-kinematics where the planner runs; install them with "
            "pip install 'zarm[torch]', or ask for auto or kernels",
            field="device",
        )
    if device == "cuda" and not _has_gpu():
        raise InvalidRequest(
            "no CUDA device can be used where the planner runs; install a GPU's driver and a CUDA build of torch, or ask "
            "for auto, kernels or cpu",
            field="device",
        )


def _has_torch() -> bool:
    return all(importlib.util.find_spec(name) for name in ("torch", "pytorch_kinematics"))


@lru_cache(maxsize=1)
def _has_gpu() -> bool:
    """Whether torch has a CUDA device; torch is loaded only if a driver for one is installed."""
    if not _has_torch() or not any(map(Path.exists, map(Path, ("/dev/nvidiactl", "/dev/dxg", "/dev/nvhost-gpu")))):
        return False
    import torch

    return torch.cuda.is_available()


def _chain(model: RobotModel, device: Device) -> SerialChain:
    import torch

    # Plans use the other cores; and two threads sharing two busy cores took nine times as long as one for 1000 poses.
    torch.set_num_threads(1)
    return _chain_of(_urdf(model), model.robot.descriptor.tip_link, device)


@lru_cache(maxsize=4)
def _chain_of(urdf: str, tip: str, device: Device) -> SerialChain:
    """The chain from a URDF's root to `tip`, in float64."""
    import pytorch_kinematics as pk
    import torch

    return pk.build_serial_chain_from_urdf(urdf.encode(), tip).to(dtype=torch.float64, device=device)


def _urdf(model: RobotModel) -> str:
    """The robot's URDF from its base to its tip: what zarm reads in it, and the attributes that pytorch-kinematics
    demands.
    """
    robot = model.robot
    lower, upper = robot.range_about([0.0] * model.dof)
    ranges = dict(zip(robot.descriptor.joints, zip(lower, upper, strict=True), strict=True))
    parts = [f"<link name={quoteattr(robot.descriptor.base_link)}/>"]
    for joint in robot.urdf.chain(robot.descriptor.base_link, robot.descriptor.tip_link):
        xyz, rpy, axis = (" ".join(map(repr, values)) for values in (joint.xyz, joint.rpy, joint.axis))
        kind, motion = joint.type, ""
        if joint.name in ranges:
            kind = "prismatic" if joint.type == "prismatic" else "revolute"
            low, high = ranges[joint.name]
            motion = f'<axis xyz="{axis}"/><limit lower="{low}" upper="{high}" effort="1" velocity="1"/>'
        parts.append(
            f'<link name={quoteattr(joint.child)}/><joint name={quoteattr(joint.name)} type="{kind}">'
            f"<parent link={quoteattr(joint.parent)}/><child link={quoteattr(joint.child)}/>"
            f'<origin xyz="{xyz}" rpy="{rpy}"/>{motion}</joint>'
        )
    return f'<robot name="chain">{"".join(parts)}</robot>'
