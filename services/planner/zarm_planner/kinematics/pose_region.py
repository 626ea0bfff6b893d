"""Goals with freedom: the poses that a goal allows for the tip, or for another frame of the robot."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import POSE_COMPONENTS, Pose, PoseDeviation, PoseTolerance, TipFrame
from zarm_geometry.frames import matrix
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.working_memory import working_memory
from zarm_geometry.world import World
from zarm_planner.deadline import Deadline
from zarm_planner.kernels.inverse import TOLERANCE
from zarm_planner.kernels.manifold import ConstraintArrays
from zarm_planner.kernels.pose_region import COMPONENTS, Regions, deviations_at, solve_regions
from zarm_planner.kinematics.ik import COLLIDING, NOTHING, IkResult, chain_of, nearest_first, with_turns
from zarm_trajectory.arrays import Array

_COMPONENTS = (*POSE_COMPONENTS, "the distance")
_ROUNDING = 2e-6
"""Rad and m of each tolerance that are left for rounding."""
_SEEDS = 500
"""Most descents for a goal. Of 3,000 points each that an SO-101, an arm with 4 joints, and an M1013 with a free axis can
reach, all are solved.
"""
_PROBES = 100
"""The same to learn which component keeps a goal from being reached."""


@dataclass(frozen=True)
class PoseRegion:
    """The configurations that bring a frame of the robot into a region of poses, and keep a path constraint if there is
    one.
    """

    model: RobotModel
    arrays: Regions

    @classmethod
    def of(
        cls,
        model: RobotModel,
        pose: Pose,
        tolerance: PoseTolerance | None,
        tip: TipFrame | None,
        field: str,
        constraint: ConstraintArrays | None = None,
    ) -> Self:
        """The region around a goal's `pose`. Raises InvalidRequest for a `tip` that the robot lacks, in the request's
        `field`.
        """
        joint, frame = tip_frame(model, tip, field)
        middle, allowed = matrix(pose.position, pose.orientation), tolerance or PoseTolerance()
        own = np.ascontiguousarray(middle[:3, :3].T)
        frames, joints, poses = [frame], [joint], [middle]
        turns, shifts = [own], [own if allowed.frame == "tool" else np.eye(3)]
        bounds = [np.maximum(np.array(allowed.bounds) - _ROUNDING, 0.0)]
        if constraint is not None:
            frames.append(model.offset[-1])
            joints.append(model.tip_joint)
            poses.append(constraint.start)
            turns.append(constraint.frame)
            shifts.append(constraint.frame)
            bounds.append(np.where(np.isin(np.arange(COMPONENTS), constraint.axes), 0.0, np.inf))
        return cls(
            model,
            Regions(
                chain_of(model),
                np.array(frames),
                np.array(joints, np.int64),
                np.array(poses),
                np.array(turns),
                np.array(shifts),
                np.array(bounds),
            ),
        )

    def solve(
        self,
        near: Array,
        *,
        world: World | None,
        max_solutions: int,
        seed: int,
        deadline: Deadline,
        descents: int = _SEEDS,
    ) -> tuple[IkResult, Array]:
        """Solutions as `ik.solve_ik` promises them, each moved inside the region to where `near` (dof,) reaches it
        soonest; and the deviations (n, 7) of the best attempt from each region, if there is none.
        """
        model = self.model
        free, colliding = np.empty((max_solutions, model.dof)), np.empty((COLLIDING, model.dof))
        missed = np.zeros(COMPONENTS * len(self.arrays.joint))
        lower, upper = model.range_about(near)
        found = solve_regions(
            self.arrays._replace(chain=self.arrays.chain._replace(lower=lower, upper=upper)),
            model.arrays,
            (world or NOTHING).arrays,
            working_memory(model.arrays),
            world is not None,
            np.array(near, np.float64, order="C"),
            model.velocity,
            free,
            colliding,
            missed,
            np.array([seed], np.uint64),
            descents,
            deadline.at,
        )
        deviations = missed.reshape(-1, COMPONENTS)
        distance, angle = deviations[0, 6], np.linalg.norm(deviations[0, :3])
        result = IkResult(
            with_turns(model, free[: found.free], near, max_solutions),
            nearest_first(colliding[: found.colliding], near),
            float(distance),
            float(angle),
        )
        return result, deviations

    def deviation(self, q: Array) -> PoseDeviation:
        """By how much the frame at `q` (dof,) is off the middle of the region, in rad and m."""
        out = np.empty(COMPONENTS * len(self.arrays.joint))
        deviations_at(self.arrays, np.array(q, np.float64, order="C"), out)
        a, b, c, x, y, z = out[:6].tolist()
        return a, b, c, x, y, z

    def shortfall(self, deviations: Array) -> str:
        """A phrase saying which components of an attempt's `deviations` (n, 7) exceed their tolerance."""
        phrases = []
        for off, allowed, of in zip(deviations, self.arrays.tolerance, ("", " of the path constraint"), strict=False):
            for i in np.flatnonzero(np.abs(off) > allowed + TOLERANCE).tolist():
                factor, unit = (np.rad2deg(1.0), "deg") if i < 3 else (1e3, "mm")
                phrases.append(
                    f"{_COMPONENTS[i]}{of} is off by {abs(off[i]) * factor:.1f} {unit} ({allowed[i] * factor:.1f} {unit} allowed)"
                )
        return " and ".join(phrases)

    @property
    def with_any_turn(self) -> PoseRegion:
        """The same positions with any orientation."""
        tolerance = self.arrays.tolerance.copy()
        tolerance[0, :3] = np.inf
        return replace(self, arrays=self.arrays._replace(tolerance=tolerance))

    def blocking(self, near: Array, seed: int, deadline: Deadline) -> tuple[str, ...]:
        """The components that keep the goal from being reached: each of them, free, would do. None if it takes more
        than one.
        """
        names = []
        for i in np.flatnonzero(np.isfinite(self.arrays.tolerance[0])).tolist():
            tolerance = self.arrays.tolerance.copy()
            tolerance[0, i] = np.inf
            freed = replace(self, arrays=self.arrays._replace(tolerance=tolerance))
            found, _ = freed.solve(near, world=None, max_solutions=1, seed=seed, deadline=deadline, descents=_PROBES)
            if len(found.solutions):
                names.append(_COMPONENTS[i])
        return tuple(names)


def tip_frame(model: RobotModel, tip: TipFrame | None, field: str) -> tuple[int, Array]:
    """The joint that carries the tip of a goal, -1 for the base, and the tip (4, 4) in that joint's frame.

    Raises InvalidRequest for a link that is not the robot's, or is moved by other joints, or not at all.
    """
    if tip is None:
        return model.tip_joint, model.offset[-1]
    offset = matrix(tip.offset.position, tip.offset.orientation)
    attached = [body for body in model.bodies if body.name == tip.link and body.name not in model.robot.urdf.links]
    if attached:
        return attached[0].joint, attached[0].origin @ offset
    carried = _carried_links(model)
    if tip.link not in carried:
        names = ", ".join((*carried, *(body.name for body in model.bodies if body.name not in carried)))
        raise InvalidRequest(
            f"{tip.link} is neither a link that the joints move nor an attached object; those are {names}",
            field=f"{field}.link",
        )
    joint, frame = carried[tip.link]
    return joint, frame @ offset


def _carried_links(model: RobotModel) -> dict[str, tuple[int, Array]]:
    """The links that the robot's joints move: the joint that carries each, and the link (4, 4) in its frame."""
    carried = {}
    for link in model.robot.urdf.links:
        with suppress(InvalidRequest):  # of another tree, or moved by other joints
            joint, frame = model.mount(link)
            if joint >= 0:
                carried[link] = joint, frame
    return carried
