"""The node `move_group`, with all that clients of MoveIt find there."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, MutableMapping
from contextlib import contextmanager
from typing import Any

from moveit_msgs.srv import (
    GetCartesianPath,
    GetGroupUrdf,
    GetMotionPlan,
    GetMotionSequence,
    GetMultiStateValidity,
    GetPositionFK,
    GetPositionIK,
    GetStateValidity,
)
from rcl_interfaces.msg import ParameterDescriptor
from std_msgs.msg import String

from zarm_contract.errors import InternalError, ZarmError
from zarm_ros_bridge.action_servers import ActionServers
from zarm_ros_bridge.convert.colours import Colour
from zarm_ros_bridge.description import shown_description
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.frames import Frames
from zarm_ros_bridge.moveit.actions import Actions, PlansByTrajectory
from zarm_ros_bridge.moveit.arm_groups import ArmGroups
from zarm_ros_bridge.moveit.cartesian_path import CartesianPaths
from zarm_ros_bridge.moveit.display import PlannedPaths
from zarm_ros_bridge.moveit.error_codes import error_code
from zarm_ros_bridge.moveit.gripper_groups import GripperGroups
from zarm_ros_bridge.moveit.kinematics import Kinematics
from zarm_ros_bridge.moveit.planners import Planners
from zarm_ros_bridge.moveit.requests import MotionPlanRequests, ask
from zarm_ros_bridge.moveit.scene import PlanningScenes
from zarm_ros_bridge.moveit.servo_node import ServoNode
from zarm_ros_bridge.moveit.srdf import semantic_description
from zarm_ros_bridge.moveit.states import robot_trajectory, trajectory_start
from zarm_ros_bridge.ros import LATCHED, Ros
from zarm_ros_bridge.servo_commands import ServoCommands
from zarm_ros_bridge.turns import Turns

log = logging.getLogger(__name__)

NODE = "move_group"
WORKERS = 8
"""Number of requests handled at once."""

Fill = Callable[[Any, Any], None]
"""`fill(request, response)` fills in a response, or raises ZarmError."""


@contextmanager
def move_group(
    ros: Ros,
    engine: Engine,
    frames: Frames,
    servers: ActionServers,
    turns: Turns,
    colours: MutableMapping[str, Colour],
    commands: ServoCommands,
    group: str,
) -> Iterator[None]:
    """Serve on the node of `ros`; call before `spin`. `group` is the name of the group of all joints; those of the descriptor,
    and of grippers, have their own."""
    _describe(ros, engine, group)
    frames.remember()
    requests = MotionPlanRequests(engine, frames, ArmGroups(engine, group))
    PlannedPaths(ros, engine)
    Planners(ros, engine)
    ServoNode(ros, commands)
    with PlanningScenes(ros, engine, frames, colours) as scenes:
        actions = Actions(ros, engine, frames, requests, scenes, servers, turns)
        Services(ros, engine, frames, requests, actions.plans)
        yield


def _describe(ros: Ros, engine: Engine, group: str) -> None:
    semantic = semantic_description(engine.robot, group)
    for name, text in (
        ("robot_description", shown_description(engine.robot)),
        ("robot_description_semantic", semantic),
    ):
        ros.node.declare_parameter(name, text, ParameterDescriptor(name=name, read_only=True))
    publisher = ros.node.create_publisher(String, "robot_description_semantic", LATCHED)
    publisher.publish(String(data=semantic))


class Services:
    """The services that plan and compute."""

    def __init__(
        self, ros: Ros, engine: Engine, frames: Frames, requests: MotionPlanRequests, plans: PlansByTrajectory
    ) -> None:
        self._engine = engine
        self._frames = frames
        self._requests = requests
        self._plans = plans
        self._grippers = GripperGroups(engine)
        self._paths = CartesianPaths(engine, frames, requests.groups)
        self._log = ros.node.get_logger()
        kinematics = Kinematics(engine, frames, requests.groups)
        for kind, name, fill, codes in (
            (GetMotionPlan, "plan_kinematic_path", self._plan, lambda response: response.motion_plan_response),
            (GetMotionSequence, "plan_sequence_path", self._sequence, lambda response: response.response),
            (GetCartesianPath, "compute_cartesian_path", self._cartesian, _itself),
            (GetPositionFK, "compute_fk", kinematics.fk, _itself),
            (GetPositionIK, "compute_ik", kinematics.ik, _itself),
            (GetStateValidity, "check_state_validity", kinematics.check, None),
            (GetMultiStateValidity, "check_multi_state_validity", kinematics.check_all, None),
            (GetGroupUrdf, "get_urdf", self._urdf, _itself),
        ):
            ros.serve(kind, name, self._answering(name, fill, codes))

    def _answering(self, name: str, fill: Fill, codes: Callable[[Any], Any] | None) -> Callable[[Any, Any], Any]:
        """A service; `codes(response)` has the field `error_code`. Errors are logged on ROS too."""

        def answer(request: Any, response: Any) -> Any:
            error: ZarmError | None = None
            try:
                fill(request, response)
            except ZarmError as problem:
                error = problem
            except Exception:  # one request fails and the service continues; in rclpy it would end the thread
                log.exception("request failed service=%s", name)
                error = InternalError("the ROS bridge failed on this request; its log has the trace")
            if error is not None:
                self._log.warning(f"{name}: {error}")
            if codes is not None:
                codes(response).error_code = error_code(error)
            return response

        return answer

    def _plan(self, request: Any, response: Any) -> None:
        answer, began = response.motion_plan_response, time.monotonic()
        answer.group_name = request.motion_plan_request.group_name
        if answer.group_name in self._grippers:
            motion = self._grippers.plan(request.motion_plan_request)
            answer.trajectory_start, answer.trajectory = motion.start, motion.trajectory
            return
        plan = self._plans.remember(
            self._requests.plan(request.motion_plan_request, lambda wanted: ask(self._engine, wanted))
        )
        answer.planning_time = time.monotonic() - began
        answer.trajectory_start = trajectory_start(plan)
        answer.trajectory = robot_trajectory(plan, self._frames.links.base)

    def _sequence(self, request: Any, response: Any) -> None:
        answer, began = response.response, time.monotonic()
        plan = self._plans.remember(
            self._requests.plan_sequence(request.request.items, lambda wanted: ask(self._engine, wanted))
        )
        answer.planning_time = time.monotonic() - began
        answer.sequence_start = trajectory_start(plan)
        answer.planned_trajectories = [robot_trajectory(plan, self._frames.links.base)]

    def _cartesian(self, request: Any, response: Any) -> None:
        plan, response.fraction = self._paths.plan(request, lambda wanted: ask(self._engine, wanted))
        if plan is not None:
            self._plans.remember(plan)
            response.start_state = trajectory_start(plan)
            response.solution = robot_trajectory(plan, self._frames.links.base)

    def _urdf(self, request: Any, response: Any) -> None:
        self._requests.groups.of(request.group_name)
        response.urdf_string = shown_description(self._engine.robot)


def _itself(response: Any) -> Any:
    return response
