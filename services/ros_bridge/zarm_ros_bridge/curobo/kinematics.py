"""Services of forward and inverse kinematics."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from geometry_msgs.msg import Pose as RosPose
from sensor_msgs.msg import JointState as RosJointState
from std_msgs.msg import Bool

from zarm_contract.errors import InvalidRequest, PlanningFailed
from zarm_contract.messages import IkRequest, Pose
from zarm_ros_bridge.answers import with_error_msg, with_message
from zarm_ros_bridge.convert.joints import positions_of, ros_positions
from zarm_ros_bridge.convert.poses import pose_of, ros_pose
from zarm_ros_bridge.curobo.generations.generation import Generation
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.ros import Ros

if TYPE_CHECKING:
    from curobo_msgs.srv import Fk, Ik, IkBatch, WarmupFK, WarmupIK

LARGEST_BATCH = 1000
"""Most poses or joint states in one request."""
_SECONDS = 65.0
"""Longest wait (s) for a batch, for which the planner allows 60 s."""


class Kinematics:
    """ik, ik_batch, fk, warmup_ik and warmup_fk."""

    def __init__(self, ros: Ros, engine: Engine, generation: Generation) -> None:
        self._engine = engine
        generation.serve(ros, "Ik", "~/ik", with_error_msg(self._ik))
        generation.serve(ros, "IkBatch", "~/ik_batch", with_error_msg(self._ik_batch))
        generation.serve(ros, "Fk", "~/fk", with_error_msg(self._fk))
        generation.serve(ros, "WarmupIK", "~/warmup_ik", with_message(self._warmup_ik))
        generation.serve(ros, "WarmupFK", "~/warmup_fk", with_message(self._warmup_fk))

    def _ik(self, request: Ik.Request, response: Ik.Response) -> str:
        (response.joint_states,), (response.joint_states_valid,) = self._solved([pose_of(request.pose, "pose")])
        if not response.joint_states_valid.data:
            raise _unsolved("the pose", "pose")
        return ""

    def _ik_batch(self, request: IkBatch.Request, response: IkBatch.Response) -> str:
        _check_count(len(request.poses), "poses")
        poses = [pose_of(pose, f"poses[{i}]") for i, pose in enumerate(request.poses)]
        response.joint_states, response.joint_states_valid = self._solved(poses)
        lacking = [i for i, valid in enumerate(response.joint_states_valid) if not valid.data]
        if lacking:
            raise _unsolved(f"{len(lacking)} of {len(poses)} poses", f"poses[{lacking[0]}]")
        return ""

    def _solved(self, poses: Sequence[Pose]) -> tuple[list[RosJointState], list[Bool]]:
        """For each pose joints near the present ones, or an empty joint state, and whether there is a solution."""
        joints, request = self._engine.joints, IkRequest(poses=tuple(poses))
        found = self._engine.client.request_ik(request).solutions
        states = [ros_positions(joints, rows[0]) if rows else RosJointState() for rows in found]
        return states, [Bool(data=bool(rows)) for rows in found]

    def _fk(self, request: Fk.Request, response: Fk.Response) -> str:
        _check_count(len(request.joint_states), "joint_states")
        readable: dict[int, tuple[float, ...]] = {}
        fault: InvalidRequest | None = None
        valid = []
        for i, state in enumerate(request.joint_states):
            try:
                readable[i] = positions_of(state, self._engine.joints, f"joint_states[{i}]")
                self._check_range(readable[i], f"joint_states[{i}]")
                valid.append(True)
            except InvalidRequest as error:
                fault = fault or error
                valid.append(False)
        poses = self._poses(list(readable.values())) if readable else []
        placed = dict(zip(readable, poses, strict=True))
        response.poses = [ros_pose(placed[i]) if i in placed else RosPose() for i in range(len(valid))]
        response.joint_states_valid = [Bool(data=one) for one in valid]
        if fault is not None:
            raise fault
        return ""

    def _poses(self, joints: Sequence[tuple[float, ...]]) -> Sequence[Pose]:
        return self._engine.client.fk(joints, timeout=_SECONDS)

    def _check_range(self, positions: tuple[float, ...], field: str) -> None:
        robot = self._engine.robot
        for name, value, low, high in zip(self._engine.joints, positions, robot.lower, robot.upper, strict=True):
            if not low <= value <= high:
                raise InvalidRequest(
                    f"{name} at {value:.4f} is outside its range, {low:.4f} to {high:.4f}; its pose is computed all the same",
                    field=field,
                )

    def _warmup_ik(self, request: WarmupIK.Request, _: WarmupIK.Response) -> str:
        _check_count(request.batch_size, "batch_size")
        (home,) = self._poses([self._engine.robot.descriptor.home])
        started = time.monotonic()
        self._solved([home] * request.batch_size)
        return f"Inverse kinematics of {request.batch_size} poses took {time.monotonic() - started:.3f} s"

    def _warmup_fk(self, request: WarmupFK.Request, _: WarmupFK.Response) -> str:
        _check_count(request.batch_size, "batch_size")
        started = time.monotonic()
        self._poses([self._engine.robot.descriptor.home] * request.batch_size)
        return f"Forward kinematics of {request.batch_size} joint states took {time.monotonic() - started:.3f} s"


def _check_count(count: int, field: str) -> None:
    if not 1 <= count <= LARGEST_BATCH:
        raise InvalidRequest(f"{count} is outside 1 to {LARGEST_BATCH}, which one request may have", field=field)


def _unsolved(what: str, field: str) -> PlanningFailed:
    return PlanningFailed(
        f"{what} cannot be reached by joints within their ranges that are free of collision; move it, choose another "
        "orientation, or correct the scene",
        code="unreachable",
        field=field,
    )
