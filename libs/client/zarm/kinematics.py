"""Kinematics of a robot, and its distance to the scene."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from zarm.calls import Calls
from zarm.connection import ANSWER_SECONDS
from zarm.values import Pose, joints_of, made, pose_of, rows
from zarm_contract.messages import (
    CheckRequest,
    CheckResult,
    FkRequest,
    IkRequest,
    IkSolutions,
    InverseDynamics,
    InverseDynamicsRequest,
    PoseGoal,
    TipFrame,
)
from zarm_contract.messages import Pose as PoseMessage

if TYPE_CHECKING:
    from zarm.values import Numbers, Rows

BATCH_SECONDS = 65.0
"""Longest wait (s) for a batch, which the planner limits to 60 s."""


class Kinematics(Calls):
    """Forward and inverse kinematics, and distances, as the planner computes them."""

    def fk(
        self,
        joints: Rows,
        *,
        group: str | None = None,
        tip: str | TipFrame | None = None,
        timeout: float = ANSWER_SECONDS,
    ) -> list[Pose]:
        """The tip's pose at each row of the robot's joint positions (rad), up to 1000 of them; with a `group`, that of its tip. `tip` is another frame
        of the robot: the name of a link or of an attached object, or a `zarm.TipFrame`.
        """
        frame = made(TipFrame, link=tip) if isinstance(tip, str) else tip
        request = made(FkRequest, joints=rows(joints, "joints"), group=group, tip=frame)
        poses = self._ask(self._keys.fk, request, timeout=timeout).poses
        return [pose_of(pose) for pose in poses]

    def ik(
        self,
        pose: PoseMessage | PoseGoal,
        *,
        near: Numbers | None = None,
        max_solutions: int = 8,
        collision_free: bool = True,
        seed: int = 0,
        group: str | None = None,
    ) -> list[tuple[float, ...]]:
        """Joint positions (rad) that reach a tip pose, nearest to `near` (default: measured) first. Empty if there are
        none. The pose may be a `PoseGoal` with freedom. With a `group` the pose is that of its tip, and the positions are those
        of its joints; `near` is that of the whole robot."""
        free = pose if isinstance(pose, PoseGoal) else None
        request = made(
            IkRequest,
            poses=(PoseMessage(position=pose.position, orientation=pose.orientation),),
            tolerance=free and free.tolerance,
            tip=free and free.tip,
            near=joints_of(near, "near"),
            max_solutions=max_solutions,
            collision_free=collision_free,
            seed=seed,
            group=group,
        )
        return list(self.request_ik(request, timeout=ANSWER_SECONDS).solutions[0])

    def request_ik(self, request: IkRequest, *, timeout: float = BATCH_SECONDS) -> IkSolutions:
        """Inverse kinematics of up to 1000 poses, with a message."""
        return self._ask(self._keys.ik, request, timeout=timeout)

    def inverse_dynamics(
        self,
        joints: Rows,
        *,
        velocity: Rows | None = None,
        acceleration: Rows | None = None,
        timeout: float = ANSWER_SECONDS,
    ) -> InverseDynamics:
        """The torque (Nm, N if prismatic) of each joint in states of motion, up to 1000 rows of joint positions (rad), velocities (rad/s) and
        accelerations (rad/s²), with what the robot carries; without these it stands still.

        The reply has none if the URDF does not state the inertia of each link.
        """
        request = made(
            InverseDynamicsRequest,
            joints=rows(joints, "joints"),
            velocity=None if velocity is None else rows(velocity, "velocity"),
            acceleration=None if acceleration is None else rows(acceleration, "acceleration"),
        )
        return self._ask(self._keys.inverse_dynamics, request, timeout=timeout)

    def check(
        self,
        joints: Rows | None = None,
        *,
        spheres: bool = False,
        points: bool = False,
        torque: bool = False,
        timeout: float = ANSWER_SECONDS,
    ) -> Sequence[CheckResult]:
        """The distance (m) of the robot to the scene and to itself at each row of joint positions (rad), up to 1000 of
        them; by default at the measured ones.

        With `spheres`, also the distance of each collision sphere; with `points`, the two nearest points; with `torque`, what holds each joint
        still, with what the robot carries.
        """
        where = None if joints is None else rows(joints, "joints")
        request = made(CheckRequest, joints=where, spheres=spheres, points=points, torque=torque)
        return self._ask(self._keys.check, request, timeout=timeout).results
