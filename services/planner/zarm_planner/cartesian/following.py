"""A path in joint space along which the tip follows a curve of poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zarm_contract.errors import PlanningFailed
from zarm_geometry.collision import is_free
from zarm_geometry.working_memory import working_memory
from zarm_planner.cartesian.curve import ToolCurve
from zarm_planner.cartesian.task import ToolTask
from zarm_planner.deadline import Deadline
from zarm_planner.kernels.inverse import TOLERANCE
from zarm_planner.kernels.pose_region import Regions
from zarm_planner.kernels.tool_path import Breadth, follow, nearest_at, straighten
from zarm_planner.kinematics.ik import NOTHING
from zarm_planner.scene.planning_scene import PlanningScene
from zarm_trajectory.arrays import Array

_JUMP = 0.5
"""Rad between two stations, some 10 mm apart: what moves further is a jump, or so near a singularity that it is one."""
_WIDTH = 24
"""Configurations that the search keeps at each station."""
_ALTERNATIVES = 3
"""Ways that it tries from each, besides the shortest."""
_TURN = 0.25
"""Rad that such a way may lead aside."""
_AT_LIMIT = 1e-6
"""Rad: a joint that is nearer to its limit is at it."""


@dataclass(frozen=True)
class Following:
    """Follows a curve from the configuration `start` (dof,) on, with the freedom of the `task`."""

    scene: PlanningScene
    deadline: Deadline
    seed: int
    curve: ToolCurve
    task: ToolTask
    start: Array

    def path(self) -> Array:
        """Joints (n, dof) at the curve's stations; from one to the next no joint jumps.

        Raises PlanningFailed (`no_path`) that says how far the curve can be followed, and what is in the way.
        """
        poses = self.curve.poses(self.curve.stations)
        shortest, reached = self._followed(poses, Breadth(0, 0.0, _JUMP), 1, checked=False)
        path: Array | None = None if shortest is None else self._straight(poses, shortest, checked=False)
        if not self.task.has_freedom or (path is not None and self._open(path)):
            if path is None:
                raise self._stopped(poses, reached, checked=False)
            return path
        searched, furthest = self._followed(poses, Breadth(_ALTERNATIVES, _TURN, _JUMP), _WIDTH, checked=True)
        if searched is not None:
            return self._straight(poses, searched, checked=True)
        if path is not None:  # spheres are larger than the links: verification will tell
            return path
        raise self._stopped(poses, furthest if len(furthest) >= len(reached) else reached, checked=True)

    def _open(self, path: Array) -> bool:
        return is_free(self.scene.model, self.scene.world, path)

    def _regions(self) -> Regions:
        """Regions that a kernel may move along the curve."""
        arrays = self.task.region.arrays
        return arrays._replace(pose=arrays.pose.copy(), turn=arrays.turn.copy(), shift=arrays.shift.copy())

    def _followed(self, poses: Array, breadth: Breadth, width: int, *, checked: bool) -> tuple[Array | None, Array]:
        """The path (n, dof) to the end of the curve if it is reached, and the path as far as it is."""
        model = self.scene.model
        reached = np.empty((len(poses), width, model.dof))
        parents = np.zeros((len(poses), width), np.int64)
        counts = np.zeros(len(poses), np.int64)
        done = follow(
            self._regions(),
            model.arrays,
            (self.scene.world if checked else NOTHING).arrays,
            working_memory(model.arrays),
            checked,
            poses,
            self.start[None],
            model.velocity,
            breadth,
            reached,
            parents,
            counts,
            np.array([self.seed], np.uint64),
            self.deadline.at,
        )
        self.deadline.check()
        path, at = np.empty((done, model.dof)), 0
        for station in range(done - 1, -1, -1):
            path[station] = reached[station, at]
            at = int(parents[station, at])
        return (path if done == len(poses) else None), path

    def _straight(self, poses: Array, path: Array, *, checked: bool) -> Array:
        if not self.task.has_freedom:
            return path
        model = self.scene.model
        straightened = path.copy()
        straighten(
            self._regions(),
            model.arrays,
            (self.scene.world if checked else NOTHING).arrays,
            working_memory(model.arrays),
            checked,
            poses,
            straightened,
            self.deadline.at,
        )
        self.deadline.check()
        return straightened

    def _stopped(self, poses: Array, path: Array, *, checked: bool) -> PlanningFailed:
        """The error of a curve that can be followed only so far, along `path` (m, dof)."""
        stations = self.curve.stations
        station = len(path)
        fraction = float(stations[station - 1] / stations[-1])
        q = path[-1].copy()
        missed = nearest_at(self._regions(), poses[station], q)
        x, y, z = poses[station, :3, 3].tolist()
        return PlanningFailed(
            f"the curve can be followed for {100.0 * fraction:.1f} % of its way: near ({x:.3f}, {y:.3f}, {z:.3f}) m "
            f"{self._obstacle(path[-1], q, missed, checked=checked)}",
            code="no_path",
            fraction=fraction,
        )

    def _obstacle(self, before: Array, q: Array, missed: float, *, checked: bool) -> str:
        """What keeps the tip from the station after the configuration `before`; `q` (dof,) is as near as it gets."""
        model = self.scene.model
        joints = model.robot.descriptor.joints
        at_limit = np.minimum(q - model.lower, model.upper - q) < _AT_LIMIT
        remedy = "move the curve, turn the tool, or start in another configuration"
        if missed > TOLERANCE and at_limit.any():
            names = " and ".join(joints[k] for k in np.flatnonzero(at_limit))
            return f"{names} would leave the range of the joint; {remedy}"
        if missed > TOLERANCE:
            return f"the arm reaches no further (a singularity); {remedy}"
        if np.abs(q - before).max() > _JUMP:
            joint = joints[int(np.argmax(np.abs(q - before)))]
            return f"{joint} would have to turn by {np.rad2deg(np.abs(q - before).max()):.0f} deg at once (a singularity); {remedy}"
        nearest = self.scene.exact.nearest(q, self.deadline.check)
        a, b = nearest.pair or ("the robot", "itself")
        return f"{a} would come too near to {b}; clear the way, lower margin, or move the curve"
