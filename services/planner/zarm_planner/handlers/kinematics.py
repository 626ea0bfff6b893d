"""Forward and inverse kinematics, answered."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import FkPoses, FkRequest, IkRequest, IkSolutions, TipFrame
from zarm_geometry.frames import matrix, pose_of
from zarm_planner.deadline import Deadline
from zarm_planner.goals.joints import checked
from zarm_planner.group import Group
from zarm_planner.handlers.state import BATCH_TIMEOUT, PlannerState
from zarm_planner.kinematics.batches import batch_fk, batch_ik, batch_regions
from zarm_planner.kinematics.pose_region import PoseRegion, tip_frame
from zarm_runtime.requester import requester
from zarm_trajectory.arrays import Array
from zarm_trajectory.turns import whole_turns


class KinematicsHandlers:
    """Answers requests for poses of joints and joints of poses."""

    def __init__(self, state: PlannerState) -> None:
        self._state = state

    def ik(self, request: IkRequest) -> IkSolutions:
        """Joints for poses. Raises InvalidRequest."""
        model = self._state.model
        near = self._state.measured_or_home() if request.near is None else checked(model, request.near, "near")
        group = Group.of_tip(model.robot, request.group)
        poses = np.array([matrix(pose.position, pose.orientation) for pose in request.poses])

        def work(deadline: Deadline) -> IkSolutions:
            scene = self._state.scenes.present(self._state.settings.margin, openings=self._state.grippers.present())
            turns = whole_turns(near, model.continuous)
            begin = near - turns
            if group is not None:
                scene = group.scene(scene, begin)
                begin, turns = begin[group.joints], turns[group.joints]
            batch: Callable[..., list[Array]] = partial(batch_ik, scene.model, poses)
            if request.tolerance is not None or request.tip is not None:
                batch = partial(
                    batch_regions,
                    [PoseRegion.of(scene.model, pose, request.tolerance, request.tip, "tip") for pose in request.poses],
                )
            found = batch(
                begin,
                world=scene.world if request.collision_free else None,
                max_solutions=request.max_solutions,
                seed=request.seed,
                device=request.device,
                deadline=deadline,
                exact=scene.exact if request.collision_free else None,
            )
            return IkSolutions(solutions=tuple(tuple(map(tuple, (rows + turns).tolist())) for rows in found))

        return self._state.scheduler.run(work, requester(), BATCH_TIMEOUT)

    def fk(self, request: FkRequest) -> FkPoses:
        """Poses for joints. Raises InvalidRequest."""
        joints = np.array([checked(self._state.model, q, f"joints.{i}") for i, q in enumerate(request.joints)])
        if request.tip is not None:
            return self._fk_frame(request.tip, request.group, joints)
        model = self._state.scenes.robot()
        group = Group.of_tip(model.robot, request.group)
        if group is None:
            poses = batch_fk(model, joints, request.device)
        else:
            poses = model.fk_link(model.robot.tip_of(group.names), joints)
        return FkPoses(poses=tuple(pose_of(pose) for pose in poses))

    def _fk_frame(self, tip: TipFrame, group: str | None, joints: Array) -> FkPoses:
        if group is not None:
            raise InvalidRequest("the tip names the frame already; leave the group out", field="group")
        model = self._state.scenes.robot()
        poses = model.fk_frame(tip_frame(model, tip, "tip"), joints)
        return FkPoses(poses=tuple(map(pose_of, poses)))
