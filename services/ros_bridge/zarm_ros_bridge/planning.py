"""Services that plan, and that choose how."""

from __future__ import annotations

import threading
import time

from std_srvs.srv import Trigger

from curobo_msgs.srv import GetPlanners, SetPlanner, TrajectoryGeneration
from zarm_contract.errors import Busy, DeadlineExceeded, InvalidRequest, PlanningFailed, Unavailable, ZarmError
from zarm_contract.messages import (
    Goal,
    IkRequest,
    PathConstraint,
    Plan,
    PlanRequest,
    Pose,
)
from zarm_ros_bridge.answers import with_message
from zarm_ros_bridge.convert.fields import in_terms_of
from zarm_ros_bridge.convert.joints import Positions, is_empty, positions_of
from zarm_ros_bridge.convert.plans import goal_of, path_constraint_of, pose_goal, poses_of, target_of
from zarm_ros_bridge.convert.trajectories import ros_joint_states
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.parameters import PLANNERS, Parameters
from zarm_ros_bridge.rereading import reread_robot
from zarm_ros_bridge.ros import Ros

_WITHOUT_ENGINE = ("mpc",)
"""Planners that zarm does not have yet."""
_FIELDS = {"start": "start_pose", "path_constraint": "trajectory_constraints"}
"""Fields of a plan's request beside its goal, and what they are in TrajectoryGeneration."""
_WAYS = 16
"""Joint solutions of a pose that are looked at."""


class Planning:
    """generate_trajectory, set_planner, get_planners and update_motion_gen_config."""

    def __init__(self, ros: Ros, engine: Engine, parameters: Parameters) -> None:
        self._engine = engine
        self._parameters = parameters
        self._updating = threading.Lock()
        parameters.on_change("planner_type", _choosable)
        ros.serve(TrajectoryGeneration, "~/generate_trajectory", with_message(self._generate))
        ros.serve(SetPlanner, "~/set_planner", with_message(self._set_planner))
        ros.serve(GetPlanners, "~/get_planners", self._get_planners)
        ros.serve(Trigger, "~/update_motion_gen_config", with_message(self._update))

    def _generate(self, request: TrajectoryGeneration.Request, response: TrajectoryGeneration.Response) -> str:
        joints, planner = self._engine.joints, self._parameters.value("planner_type")
        start = None if is_empty(request.start_pose) else positions_of(request.start_pose, joints, "start_pose")
        target = target_of(request, planner)
        constraint = path_constraint_of(request, target)
        if planner == "batch" and target == "target_poses":
            plan, target = self._any_of(poses_of(request), start, constraint)
        else:
            plan = self._plan(goal_of(request, target, joints), target, start, constraint, self._deadline())
        dt = self._engine.robot.descriptor.interpolation_dt
        response.trajectory, response.dt = ros_joint_states(plan.trajectory, dt), dt
        return (
            f"planned {plan.trajectory.duration:.2f} s of motion to {target} in {plan.timings.total:.3f} s; the smallest distance "
            f"to anything is {1e3 * plan.clearance:.0f} mm"
        )

    def _deadline(self) -> float:
        return time.monotonic() + float(self._parameters.value("timeout"))

    def _plan(
        self, goal: Goal, target: str, start: Positions | None, constraint: PathConstraint | None, deadline: float
    ) -> Plan:
        """A plan to the goal, which the client gave in `target`. Raises what the planner answers, in terms of the request."""
        timeout = max(0.01, deadline - time.monotonic())
        request = PlanRequest(
            goal=goal,
            start=start,
            path_constraint=constraint,
            planner="auto",
            timeout=timeout,
            max_attempts=self._parameters.value("max_attempts"),
            margin=self._parameters.value("collision_activation_distance"),
        )
        try:
            return self._engine.client.request_plan(request)
        except ZarmError as error:
            raise in_terms_of(error, {"goal.through": target, "goal": target} | _FIELDS) from error

    def _any_of(
        self, poses: tuple[Pose, ...], start: Positions | None, constraint: PathConstraint | None
    ) -> tuple[Plan, str]:
        """The plan to one of the poses, and its place: to the one that the arm is nearest to among those that can be planned to."""
        deadline, failure = self._deadline(), None
        for index in self._nearest_first(poses, self._engine.measured().position if start is None else start):
            if failure is not None and time.monotonic() > deadline:
                break
            try:
                target = f"target_poses[{index}]"
                return self._plan(pose_goal(poses[index]), target, start, constraint, deadline), target
            except (PlanningFailed, InvalidRequest, DeadlineExceeded) as error:
                failure = failure or error
        raise PlanningFailed(
            f"none of the {len(poses)} target_poses can be planned to; of the nearest: {failure}", field="target_poses"
        )

    def _nearest_first(self, poses: tuple[Pose, ...], start: Positions) -> list[int]:
        """Places of the poses, by the time that the slowest joint needs to them; those without a free solution come last."""
        request = IkRequest(poses=poses, near=start, max_solutions=_WAYS)
        found = self._engine.client.request_ik(request).solutions
        speed = self._engine.robot.descriptor.cspace.velocity

        def away(index: int) -> float:
            return min(
                (max(abs(b - a) / v for a, b, v in zip(start, q, speed, strict=True)) for q in found[index]),
                default=float("inf"),
            )

        return sorted(range(len(poses)), key=away)

    def _set_planner(self, request: SetPlanner.Request, response: SetPlanner.Response) -> str:
        before = self._parameters.value("planner_type")
        response.previous_planner = response.current_planner = before
        if request.planner_type >= len(PLANNERS):
            known = ", ".join(f"{name} {number}" for number, name in enumerate(PLANNERS))
            raise InvalidRequest(f"{request.planner_type} is not a planner; use one of {known}", field="planner_type")
        planner = PLANNERS[request.planner_type]
        _choosable(planner)
        self._parameters.set("planner_type", planner)
        response.current_planner = planner
        return f"Planner switched from '{before}' to '{planner}'"

    def _get_planners(self, _: GetPlanners.Request, response: GetPlanners.Response) -> GetPlanners.Response:
        planners = {number: name for number, name in enumerate(PLANNERS) if name not in _WITHOUT_ENGINE}
        response.planner_names, response.planner_ids = list(planners.values()), list(planners)
        response.current_planner_name = self._parameters.value("planner_type")
        response.current_planner_id = PLANNERS.index(response.current_planner_name)
        response.success = True
        return response

    def _update(self, _: Trigger.Request, __: Trigger.Response) -> str:
        if not self._updating.acquire(blocking=False):
            raise Busy(
                "the robot's file is being read again for another client; call again when that has been answered"
            )
        try:
            changed = reread_robot(self._engine)
        finally:
            self._updating.release()
        file = self._engine.robot.path
        return f"{file} has changed, and {changed}" if changed else f"{file} is as every service has it"


def _choosable(planner: str) -> None:
    """Raises Unavailable for a planner that zarm does not have yet."""
    if planner in _WITHOUT_ENGINE:
        raise Unavailable(f"the planner {planner} is not available yet; choose another one of get_planners")
