"""Generation C, autumn 2026: goals are goal sets, from each of which the planner chooses one pose."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from zarm_contract.messages import Plan
from zarm_ros_bridge.curobo.generations.b import GenerationB
from zarm_ros_bridge.curobo.motion_requests import MotionRequest, filled, motion_to, path_constraint_of, pose_sets

_FIELDS = ("goalsets", "target_joint_positions")
_READS = {"joint_space": "target_joint_positions"}


class GenerationC(GenerationB):
    """v2 of the tutorial, with goal sets."""

    letter = "c"
    additions = True

    def motion(self, request: Any, planner: str, joints: Sequence[str]) -> MotionRequest:
        """Through all goal sets, in turn; with the planner batch to one pose of any of them."""
        field = motion_to(filled(request, _FIELDS), _READS, planner, "goalsets")
        sets = [goalset.poses for goalset in request.goalsets] if field == "goalsets" else []
        constraint = path_constraint_of(
            getattr(request, "trajectory_constraints", ()),
            getattr(request, "trajectories_contraints", ()),
            field,
            {"goalsets": len(sets)},
        )
        if field == "target_joint_positions":
            return MotionRequest.to_joints(field, request, joints, constraint)
        return MotionRequest(field, request.start_pose, pose_sets(sets, field), planner == "batch", constraint)

    def goal(self, goal: Any, planner: str, joints: Sequence[str]) -> MotionRequest | None:
        """As `motion`."""
        return self.motion(goal, planner, joints) if filled(goal, _FIELDS) else None

    def set_selected(self, response: Any, asked: MotionRequest, plan: Plan | None, passed: Sequence[int]) -> None:
        """The index of the chosen pose in each goal set; -1 for one that is not reached."""
        response.selected_goal_index = asked.selected(plan, passed)

    def box(self, request: Any) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
        """None for a box without extent, the default in a request."""
        low = request.bbox_min_x, request.bbox_min_y, request.bbox_min_z
        high = request.bbox_max_x, request.bbox_max_y, request.bbox_max_z
        return (low, high) if all(a < b for a, b in zip(low, high, strict=True)) else None
