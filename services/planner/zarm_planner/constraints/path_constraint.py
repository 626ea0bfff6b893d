"""The path constraint: which parts of a tip's pose are kept, the error of a pose, and its projection."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self, TypeGuard

import numpy as np
from numpy.typing import ArrayLike

from zarm_contract.messages import POSE_COMPONENTS, PathConstraint
from zarm_geometry.joint_tree import Place
from zarm_geometry.robot_model import RobotModel
from zarm_planner.kernels.manifold import ConstraintArrays, deviations, project_all
from zarm_planner.kinematics.ik import chain_of
from zarm_trajectory.arrays import Array


def constrains(message: PathConstraint | None) -> TypeGuard[PathConstraint]:
    """Whether a request has a path constraint; one that names no axes is none."""
    return message is not None and any(message.axes)


@dataclass(frozen=True)
class ConstraintManifold:
    """The components of a tip's pose that a motion keeps at their start values.

    The pose is that in the base frame, or in the frame of another tip. The deviation of a pose T from the start pose
    T0, along the axes of that frame, is the rotation vector (axis times angle, at most pi) of R R0^T and p - p0; in the
    `tool` frame, along the tip's axes at the start, it is that of R0^T R and R0^T (p - p0). A pose keeps the constraint
    if each constrained component is within its tolerance. `seen_in` says in words along which axes.
    """

    model: RobotModel
    seen_in: str
    arrays: ConstraintArrays

    @classmethod
    def of(cls, model: RobotModel, message: PathConstraint, start: Array) -> Self:
        """The constraint of `message` for a motion from `start` (dof,) on."""
        tip, chain = model.tip_place(message.group), chain_of(model)
        reference: Place = (-1, np.eye(4))
        seen_in, axes = f"in the {message.frame} frame", np.eye(3)
        if message.relative_to is not None:
            reference = model.tip_place(message.relative_to)
            if message.frame == "base":
                seen_in = f"in the frame of the tip of {message.relative_to}"
            if reference[0] < 0:  # it stands, so the pose in the base frame is kept too
                reference, axes = (-1, np.eye(4)), reference[1][:3, :3].T
        pose = _seen(model, tip, reference, start)
        arrays = ConstraintArrays(
            chain._replace(tip=np.ascontiguousarray(tip[1])),
            np.array((tip[0], reference[0]), np.int32),
            np.ascontiguousarray(reference[1]),
            _moves(model, tip) - _moves(model, reference),
            pose,
            np.ascontiguousarray(axes if message.frame == "base" else pose[:3, :3].T),
            np.flatnonzero(message.axes).astype(np.int64),
            np.repeat((message.angle_tolerance, message.position_tolerance), 3),
        )
        return cls(model, seen_in, arrays)

    def poses(self, q: ArrayLike) -> Array:
        """The poses (..., 4, 4) that are kept, at configurations (..., dof)."""
        tip, reference = self.arrays.joints.tolist()
        return _seen(self.model, (tip, self.arrays.chain.tip), (reference, self.arrays.reference), q)

    def tip(self, q: Array) -> Array:
        """The pose (4, 4) in the base frame that keeps the tip exactly, where the reference is as at `q` (dof,)."""
        arrays = self.arrays
        joint = int(arrays.joints[1])
        if joint < 0:
            return arrays.start
        kept: Array = self.model.fk_frame((joint, arrays.reference), q) @ arrays.start
        return kept

    def deviations(self, poses: ArrayLike) -> Array:
        """Deviations (n, 6) of such poses (n, 4, 4) from the start: rad about and m along x, y, z."""
        rows = np.array(poses, np.float64, order="C").reshape(-1, 4, 4)
        out = np.empty((len(rows), 6))
        deviations(self.arrays, rows, out)
        return out

    def use(self, q: ArrayLike) -> Array:
        """The share (n,) of the tolerances that configurations (n, dof) use; above 1 the constraint is broken."""
        used = self._used(self.poses(np.reshape(q, (-1, self.model.dof))))
        worst: Array = np.max(used, axis=1, initial=0.0)
        return worst

    def violation(self, q: ArrayLike) -> tuple[int, str] | None:
        """The index of the configuration (n, dof) that breaks the constraint most, and a phrase saying by how much.

        None if the constraint is kept.
        """
        poses = self.poses(np.reshape(q, (-1, self.model.dof)))
        used = self._used(poses)
        if used.max(initial=0.0) <= 1.0:
            return None
        row = int(np.argmax(used.max(axis=1)))
        return row, self._phrase(poses[row])

    def broken_at(self, pose: Array) -> str | None:
        """A phrase saying by how much a pose (4, 4) breaks the constraint; None if it keeps it."""
        return self._phrase(pose) if self._used(pose).max(initial=0.0) > 1.0 else None

    def projected(self, q: ArrayLike) -> Array | None:
        """Configurations (n, dof) within the joint ranges, near `q` (n, dof), that keep the constraint.

        Accurate to `kernels.manifold.CLOSE`; None if not all can be found.
        """
        rows = np.array(q, np.float64, order="C").reshape(-1, self.model.dof)
        return rows if project_all(self.arrays, rows) == len(rows) else None

    def _used(self, poses: Array) -> Array:
        """The share (n, axes) of each tolerance that poses (n, 4, 4) use."""
        axes = self.arrays.axes
        used: Array = np.abs(self.deviations(poses)[:, axes]) / self.arrays.tolerance[axes]
        return used

    def _phrase(self, pose: Array) -> str:
        deviation = self.deviations(pose)[0]
        parts = []
        for i in self.arrays.axes[self._used(pose)[0] > 1.0].tolist():
            factor, unit = (np.rad2deg(1.0), "deg") if i < 3 else (1e3, "mm")
            off, allowed = abs(deviation[i]) * factor, self.arrays.tolerance[i] * factor
            parts.append(f"{POSE_COMPONENTS[i]} would be off by {off:.2f} {unit} ({allowed:.2f} {unit} allowed)")
        return f"{self.seen_in}, {' and '.join(parts)}"


def _seen(model: RobotModel, tip: Place, reference: Place, q: ArrayLike) -> Array:
    """The poses (..., 4, 4) of the tip in the reference at configurations (..., dof)."""
    pose = model.fk_frame(tip, q)
    if reference[0] < 0:
        return pose
    seen: Array = np.linalg.inv(model.fk_frame(reference, q)) @ pose
    return seen


def _moves(model: RobotModel, place: Place) -> Array:
    """1 for each joint (dof,) that moves a frame, 0 for the others."""
    return np.isin(np.arange(model.dof), model.ancestors(place[0])).astype(np.float64)
