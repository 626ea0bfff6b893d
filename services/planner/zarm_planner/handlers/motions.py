"""Plans and programs, answered."""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from typing import Any

from zarm_contract.errors import InvalidRequest, Problem, ZarmError
from zarm_contract.messages import (
    Move,
    PathConstraint,
    Plan,
    PlannedSegment,
    PlanRequest,
    PlanTimings,
    Pose,
    ProgramRequest,
    SceneRevision,
    Touch,
)
from zarm_geometry.exact import RESOLUTION
from zarm_geometry.frames import pose_of
from zarm_geometry.gripper_openings import openings_message
from zarm_geometry.robot_model import Openings, RobotModel
from zarm_planner.concurrent import ConcurrentMotion
from zarm_planner.constrained_goal import ConstrainedGoal
from zarm_planner.constraints.path_constraint import constrains
from zarm_planner.context import PlanningContext
from zarm_planner.deadline import Deadline
from zarm_planner.goals.joints import within_range
from zarm_planner.goals.moving_start import state_of
from zarm_planner.group import Group
from zarm_planner.handlers.state import PlannerState
from zarm_planner.pipeline import Verified, plan
from zarm_planner.planners.registry import AUTO
from zarm_planner.program_stage import ProgramStage
from zarm_planner.programs import ChangeAt, PlannedProgram, of_only_segment, plan_program, with_ways
from zarm_planner.scene.planning_scene import PlanningScene
from zarm_runtime.requester import requester
from zarm_trajectory.arrays import Array
from zarm_trajectory.turns import whole_turns


class MotionHandlers:
    """Answers requests for motions."""

    def __init__(self, state: PlannerState) -> None:
        self._state = state

    def plan(self, request: PlanRequest) -> Plan:
        """A verified trajectory to the goal. Raises a ZarmError saying why there is none."""
        settings, model = self._state.settings, self._state.model
        self._state.check_scene()
        planner = self._state.choose(request)
        if with_ways(request.goal):
            return self._with_ways(request)
        openings = self._state.grippers.chosen(request.openings)
        goal, group, constraint = request.goal, Group.of(model.robot, request.group, request.goal), None
        if constrains(request.path_constraint):
            goal, group, constraint = ConstrainedGoal.of(model.robot, goal, group, request.path_constraint)
        others = None
        if request.concurrent is not None:
            if request.start_state is not None:
                raise InvalidRequest(
                    "the group starts at rest beside another motion; leave this out", field="start_state"
                )
            if constraint is not None and constraint.relative_to is not None:
                raise InvalidRequest(
                    "a tip cannot be held relative to another one beside another motion; leave this out",
                    field="path_constraint.relative_to",
                )
            others = ConcurrentMotion.of(model.robot, request.concurrent, group)

        def work(deadline: Deadline) -> tuple[PlanningScene, Verified, PlanTimings]:
            limits = self._state.limits(
                request.velocity_scale or settings.velocity_scale,
                request.acceleration_scale or settings.acceleration_scale,
            )
            motion: Array | None = None
            if request.start_state is not None:
                state = state_of(model, limits, request.start_state)
                start, motion = state[0], state[1:]
            else:
                start = within_range(model, self._state.measured() if request.start is None else request.start, "start")
            if others is not None:
                start = others.at(start)
            given = request.self_margin
            self_margin = model.robot.descriptor.self_margin if given is None else given
            context = PlanningContext(
                scene=self._state.scenes.present(
                    settings.margin if request.margin is None else request.margin, self_margin, openings
                ),
                limits=limits,
                deadline=deadline,
                path_constraint=constraint,
                max_attempts=request.max_attempts or settings.max_attempts,
                optimize_s=settings.optimize_s if request.optimize_s is None else request.optimize_s,
                seed=request.seed,
            )
            # Kernels work in single precision, which needs small angles.
            turns = whole_turns(start, model.continuous)
            if group is None:
                verified = plan(planner, context, start - turns, goal, motion)
            elif others is not None:
                full = self._state.limits(1.0, 1.0)
                verified = others.shifted(-turns).plan(group, planner, context, start - turns, goal, full)
            else:
                verified = group.plan(planner, context, start - turns, goal, motion)
            return context.scene, verified.shifted(turns), context.timer.timings()

        scene, verified, timings = self._state.scheduler.run(
            work, requester(), request.timeout or settings.timeout, request.request_id
        )
        tips = group.names if group is not None else ()
        tip = _tip(scene.model, tips, verified)
        return self._reply(scene.revision, verified, timings, openings, tip=tip, path_constraint=constraint)

    def _reply(
        self,
        revision: SceneRevision,
        verified: Verified,
        timings: PlanTimings,
        openings: Openings,
        segments: tuple[PlannedSegment, ...] = (),
        touches: tuple[Touch, ...] = (),
        problem: Problem | None = None,
        *,
        tip: Pose,
        path_constraint: PathConstraint | None = None,
    ) -> Plan:
        model, trajectory = self._state.model, verified.trajectory
        return Plan.model_construct(  # from values just verified
            plan_id=f"p-{secrets.token_hex(4)}",
            robot=self._state.name,
            robot_hash=model.robot.hash,
            scene_revision=revision,
            trajectory=trajectory.message(model.robot.descriptor.joints),
            tip=tip,
            selected_goal_index=verified.goal_pose,
            goal_deviation=verified.deviation,
            path_constraint=path_constraint,
            tool=verified.tool,
            segments=segments,
            touches=touches,
            openings=openings_message(openings),
            torque=verified.torque,
            problem=problem,
            clearance=verified.clearance,
            too_near=verified.too_near,
            resolution=RESOLUTION,
            waypoint_times=verified.waypoint_times,
            path_length=trajectory.length,
            timings=timings,
        )

    def _with_ways(self, request: PlanRequest) -> Plan:
        """A goal with an approach or a retreat is a program of several motions."""
        refused = {
            "start_state": request.start_state is not None,
            "path_constraint": constrains(request.path_constraint),
            "concurrent": request.concurrent is not None,
        }
        for field in (field for field, given in refused.items() if given):
            raise InvalidRequest("not with an approach or a retreat; leave one of them out", field=field)
        common = ProgramRequest.model_fields.keys() & PlanRequest.model_fields.keys()
        fields: dict[str, Any] = {name: getattr(request, name) for name in common}
        segment = Move.model_construct(kind="move", goal=request.goal, group=request.group)
        try:
            plan, _ = self.program(ProgramRequest.model_construct(segments=(segment,), **fields))
        except ZarmError as error:
            raise of_only_segment(error) from error
        return plan

    def program(self, request: ProgramRequest) -> tuple[Plan, tuple[ChangeAt, ...]]:
        """A program as one motion, and what it attaches and detaches. Raises a ZarmError that names the segment."""
        settings = self._state.settings
        self._state.check_scene()

        def work(deadline: Deadline) -> tuple[ProgramStage, PlannedProgram, Array]:
            start = within_range(
                self._state.model, self._state.measured() if request.start is None else request.start, "start"
            )
            turns = whole_turns(start, self._state.model.continuous)
            stage = ProgramStage(
                self._state.model,
                self._state.store,
                self._state.scenes,
                self._state.limits,
                settings,
                request,
                deadline,
                self._state.grippers,
            )
            planned = plan_program(
                stage, start - turns, request.segments, self._state.planners, deadline.check, partial=request.partial
            )
            return stage, planned, turns

        stage, planned, turns = self._state.scheduler.run(
            work, requester(), request.timeout or settings.timeout, request.request_id
        )
        plan = self._reply(
            stage.revision,
            planned.verified.shifted(turns),
            stage.timer.timings(),
            stage.openings,
            planned.segments,
            planned.touches,
            planned.problem,
            tip=_tip(self._state.scenes.robot(), planned.groups, planned.verified),
        )
        changes = tuple(
            (at, change.model_copy(update={"joints": tuple((q + turns).tolist())})) for at, change, q in planned.changes
        )
        return plan, changes

    def planner_name(self, request: PlanRequest) -> str:
        """The name of the planner that takes a request, or would by default. Raises InvalidRequest."""
        try:
            planner = self._state.choose(request)
        except InvalidRequest:
            planner = self._state.choose(request.model_copy(update={"planner": AUTO}))
        return planner.names[request.goal.kind]


def _tip(model: RobotModel, groups: Sequence[str], verified: Verified) -> Pose:
    """Where the tip of the first of these groups is at the end of a motion; without groups, the robot's tip."""
    return pose_of(model.fk_link(model.robot.tip_of(groups), verified.trajectory.position[-1]))
