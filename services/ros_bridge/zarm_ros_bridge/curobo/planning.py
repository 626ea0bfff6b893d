"""Services that plan, and that choose the planner."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from std_srvs.srv import Trigger

from zarm_contract.errors import Busy, InvalidRequest
from zarm_ros_bridge.answers import with_message
from zarm_ros_bridge.convert.trajectories import ros_joint_states
from zarm_ros_bridge.curobo.closed_loop import check_plans
from zarm_ros_bridge.curobo.generations.generation import Generation
from zarm_ros_bridge.curobo.motions import Motions
from zarm_ros_bridge.curobo.parameters import PLANNERS, Parameters
from zarm_ros_bridge.curobo.rereading import reread_robot
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.ros import Ros

if TYPE_CHECKING:
    from curobo_msgs.srv import GetPlanners, SetPlanner, TrajectoryGeneration


class Planning:
    """generate_trajectory, set_planner, get_planners and update_motion_gen_config."""

    def __init__(
        self, ros: Ros, engine: Engine, parameters: Parameters, motions: Motions, generation: Generation
    ) -> None:
        self._engine = engine
        self._parameters = parameters
        self._motions = motions
        self._generation = generation
        self._updating = threading.Lock()
        generation.serve(ros, "TrajectoryGeneration", "~/generate_trajectory", with_message(self._generate))
        generation.serve(ros, "SetPlanner", "~/set_planner", with_message(self._set_planner))
        generation.serve(ros, "GetPlanners", "~/get_planners", self._get_planners)
        ros.serve(Trigger, "~/update_motion_gen_config", with_message(self._update))

    def _generate(self, request: TrajectoryGeneration.Request, response: TrajectoryGeneration.Response) -> str:
        generation, motions = self._generation, self._motions
        check_plans(motions.planner)
        asked = generation.motion(request, motions.planner, self._engine.joints)
        generation.set_selected(response, asked, None, ())
        plan = motions.plan(asked, self._engine.client.request_plan)
        generation.set_selected(response, asked, plan, motions.passed(asked, plan))
        dt = self._engine.robot.descriptor.interpolation_dt
        response.trajectory, response.dt = ros_joint_states(plan.trajectory, dt), dt
        return (
            f"planned {plan.trajectory.duration:.2f} s of motion to {asked.reached(plan)} in {plan.timings.total:.3f} s; the "
            f"smallest distance to anything is {1e3 * plan.clearance:.0f} mm"
        )

    def _set_planner(self, request: SetPlanner.Request, response: SetPlanner.Response) -> str:
        before = self._parameters.value("planner_type")
        response.previous_planner = response.current_planner = before
        planners = PLANNERS[: self._generation.planners]
        if request.planner_type >= len(planners):
            known = ", ".join(f"{name} {number}" for number, name in enumerate(planners))
            raise InvalidRequest(f"{request.planner_type} is not a planner; use one of {known}", field="planner_type")
        planner = planners[request.planner_type]
        self._parameters.set("planner_type", planner)
        response.current_planner = planner
        return f"Planner switched from '{before}' to '{planner}'"

    def _get_planners(self, _: GetPlanners.Request, response: GetPlanners.Response) -> GetPlanners.Response:
        planners = PLANNERS[: self._generation.planners]
        response.planner_names, response.planner_ids = list(planners), list(range(len(planners)))
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
