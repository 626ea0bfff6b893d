"""The interface of a generation of curobo_msgs, with the behaviour that most share; `a`, `b` and `c` override it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

from zarm_contract.messages import Plan
from zarm_ros_bridge.curobo.convergence import Convergence
from zarm_ros_bridge.curobo.motion_requests import MotionRequest, filled, motion_to, path_constraint_of, pose_sets
from zarm_ros_bridge.ros import Ros

_READS = {"batch": "target_poses", "multipoint": "target_poses", "joint_space": "target_joint_positions"}
"""The goal field of planners that do not read `target_pose`."""


class Generation(ABC):
    """One generation, as installed. `types` are the classes that can be served, like srv/AddObject.

    `differences` lists, one sentence each, how the installed package differs from this generation.
    """

    letter: ClassVar[str]
    planners: ClassVar[int]
    """The number of values of SetPlanner."""
    additions: ClassVar[bool] = False
    """Whether its clients expect the services of `additions`, and the obstacles on a second topic."""

    def __init__(self, types: Mapping[str, Any], differences: Sequence[str]) -> None:
        self.types = types
        self.differences = tuple(differences)

    def __str__(self) -> str:
        faults = f", but for {len(self.differences)} types" if self.differences else ""
        return f"curobo_msgs of generation {self.letter.upper()}{faults}"

    def serve(self, ros: Ros, kind: str, name: str, answer: Callable[[Any, Any], Any]) -> None:
        """Serve `name` with the type `kind`, like AddObject, if that is installed as expected."""
        if (service := self.types.get(f"srv/{kind}")) is not None:
            ros.serve(service, name, answer)

    def motion(self, request: Any, planner: str, joints: Sequence[str]) -> MotionRequest:
        """The motion that generate_trajectory, or a goal with the same fields, requests. Raises InvalidRequest."""
        field = motion_to(filled(request, ("target_pose", "target_poses", "target_joint_positions")), _READS, planner)
        poses = request.target_poses if field == "target_poses" else ()
        constraint = path_constraint_of(
            getattr(request, "trajectory_constraints", ()),  # which an action goal lacks
            getattr(request, "trajectories_contraints", ()),
            field,
            {"target_poses": len(poses)},
        )
        if field == "target_joint_positions":
            return MotionRequest.to_joints(field, request, joints, constraint)
        if field == "target_pose":
            return MotionRequest(
                field, request.start_pose, pose_sets([[request.target_pose]], field), False, constraint
            )
        if planner == "batch":
            return MotionRequest(field, request.start_pose, pose_sets([poses], field), True, constraint)
        return MotionRequest(field, request.start_pose, pose_sets([[pose] for pose in poses], field), False, constraint)

    @abstractmethod
    def goal(self, goal: Any, planner: str, joints: Sequence[str]) -> MotionRequest | None:
        """The motion that a goal of execute_trajectory requests; None: it executes the last plan. Raises
        InvalidRequest.
        """

    def set_selected(  # noqa: B027  what most have nothing to tell
        self, response: Any, asked: MotionRequest, plan: Plan | None, passed: Sequence[int]
    ) -> None:
        """Put into the response of generate_trajectory which poses of its goal sets are reached; without a plan, none.

        `passed` are those of the goal sets on the way.
        """

    @abstractmethod
    def feedback(
        self, kind: type[Any], state: str, progress: float, joint_command: Any, convergence: Convergence | None = None
    ) -> Any:
        """The feedback of a goal. `state` is that of the executor's goal, or `planning`; in closed loop, with a
        `convergence`, `tracking`, `on_target` or `aborted`.
        """

    def strategy(self, request: Any, robot_type: str) -> str:
        """The strategy that SetRobotStrategy requests, for a robot with the v1 name `robot_type`. Raises
        InvalidRequest.
        """
        name: str = request.robot_strategy
        return name

    def active(self, strategy: str, robot_type: str) -> str:
        """The message of get_robot_strategy; `robot_type` is the v1 name of the strategy."""
        return strategy

    def box(self, request: Any) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
        """The corners (m) of the part of the scene that GetVoxelGrid requests, None for all of it."""
        return None
