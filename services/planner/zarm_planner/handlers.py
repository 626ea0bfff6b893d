"""The request handlers of the planner: messages in, messages out, independent of the transport."""

from __future__ import annotations

import logging
import math
import os
import secrets
import threading
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zarm_contract.errors import ExecutionRefused, InvalidRequest, Problem, Unavailable, ZarmError
from zarm_contract.messages import (
    AttachObject,
    CancelledPlan,
    CancelPlan,
    CheckRequest,
    CheckResult,
    CheckResults,
    DetachObject,
    FkPoses,
    FkRequest,
    GripperState,
    HoldingTorque,
    IkRequest,
    IkSolutions,
    Move,
    Occupancy,
    OccupancyRequest,
    Plan,
    PlannedSegment,
    Planners,
    PlannerSettings,
    PlanRequest,
    PlanTimings,
    Pose,
    ProgramRequest,
    Scene,
    SceneEdit,
    SceneRevision,
    SetLinkCollision,
    SettingsChange,
    Touch,
    Vector3,
)
from zarm_geometry.dynamics import Dynamics
from zarm_geometry.exact import RESOLUTION
from zarm_geometry.frames import matrix, pose_of
from zarm_geometry.gripper_openings import GripperOpenings, openings_message
from zarm_geometry.occupancy import reached_cells
from zarm_geometry.robot_model import Openings, RobotModel
from zarm_geometry.sphere_distances import sphere_distances
from zarm_planner.constraints.path_constraint import constrains
from zarm_planner.context import PlanningContext
from zarm_planner.deadline import Deadline
from zarm_planner.goals.joints import checked, within_range
from zarm_planner.goals.moving_start import state_of
from zarm_planner.group import Group
from zarm_planner.kinematics.batches import batch_fk, batch_ik, batch_regions
from zarm_planner.kinematics.pose_region import PoseRegion
from zarm_planner.pipeline import Verified, plan
from zarm_planner.planners.base import Planner
from zarm_planner.planners.registry import AUTO, PLANNERS, check_name, choose, names_of
from zarm_planner.program_stage import ProgramStage
from zarm_planner.programs import PlannedProgram, SceneChange, of_only_segment, plan_program, with_ways
from zarm_planner.scene.attached_objects import carrier, check_attach, check_links
from zarm_planner.scene.map_health import STALE_SCALE, MapHealth
from zarm_planner.scene.scene_cache import SceneCache
from zarm_planner.scene.store import SceneStore
from zarm_planner.scheduler import Scheduler
from zarm_planner.warm_up import warm_up
from zarm_runtime.requester import requester
from zarm_trajectory.limits import Limits
from zarm_trajectory.quintic import Array
from zarm_trajectory.turns import whole_turns

log = logging.getLogger(__name__)

ChangeAt = tuple[float, SceneChange]
"""What a program attaches or detaches at which time (s)."""
_BATCH_TIMEOUT = 60.0
"""Time limit (s) for a batch of kinematics or checks."""


class Handlers:
    """All answers for one robot, for any number of threads, each working for its `requester`. `name` is the robot's on
    the bus.

    `measured` returns the robot's current joints (dof,), or raises ExecutionRefused (`no_joint_state`). `is_there`
    tells whether a client that had left is back. `planners` are those to choose from. `grippers` are as measured; `gripper_state` asks
    for the state of one.
    """

    def __init__(
        self,
        model: RobotModel,
        name: str,
        store: SceneStore,
        measured: Callable[[], Array],
        is_there: Callable[[str], bool] = lambda _: False,
        planners: Sequence[Planner] = PLANNERS,
        gripper_state: Callable[[str], GripperState | None] = lambda _: None,
    ) -> None:
        self._model = model
        self.grippers = GripperOpenings(model.robot.descriptor, ask=gripper_state)
        self._name = name
        self._store = store
        self._measured = measured
        self._planners = planners
        self._scheduler = Scheduler(os.cpu_count() or 1, is_there)
        self._lock = threading.Lock()
        self._settings = PlannerSettings()
        self._scaled = lru_cache(maxsize=16)(
            partial(Limits.of, model.robot)
        )  # by the scales of velocity and acceleration
        self.scenes = SceneCache(model, store)
        self.map_health = MapHealth()

    def warm_up(self, report: Callable[[str], None]) -> None:
        """Compile or load the kernels used by plans; `report` is told what comes next."""
        groups = self._model.robot.descriptor.groups
        one_tip = next((name for name, group in groups.items() if group.tip_link is not None), None)
        home = np.array(self._model.robot.descriptor.home)
        warm_up(self._model if one_tip is None else self._model.group((one_tip,), home), report)
        report("loading the scene")
        self.scenes.prepare(self._store.scene, self.grippers.present())
        try:
            self.scenes.present(self._settings.margin)
        except Unavailable as error:  # every plan will report this until the scene is edited
            log.error("scene cannot be used reason=%s", error)

    def close(self) -> None:
        """End all current work; from now on there is only Unavailable."""
        self._scheduler.close()

    def plan(self, request: PlanRequest) -> Plan:
        """A verified trajectory to the goal. Raises a ZarmError saying why there is none."""
        settings, model = self._settings, self._model
        self._check_scene()
        planner = self._choose(request)
        if with_ways(request.goal):
            return self._with_ways(request)
        openings = self.grippers.chosen(request.openings)
        group = Group.of(model.robot, request.group, request.goal)

        def work(deadline: Deadline) -> tuple[SceneRevision, Verified, PlanTimings]:
            limits = self._limits(
                request.velocity_scale or settings.velocity_scale,
                request.acceleration_scale or settings.acceleration_scale,
            )
            motion: Array | None = None
            if request.start_state is not None:
                state = state_of(model, limits, request.start_state)
                start, motion = state[0], state[1:]
            else:
                start = within_range(model, self._measured() if request.start is None else request.start, "start")
            given = request.self_margin
            self_margin = model.robot.descriptor.self_margin if given is None else given
            context = PlanningContext(
                scene=self.scenes.present(
                    settings.margin if request.margin is None else request.margin, self_margin, openings
                ),
                limits=limits,
                deadline=deadline,
                path_constraint=request.path_constraint,
                max_attempts=request.max_attempts or settings.max_attempts,
                optimize_s=settings.optimize_s if request.optimize_s is None else request.optimize_s,
                seed=request.seed,
            )
            # Kernels work in single precision, which needs small angles.
            turns = whole_turns(start, model.continuous)
            if group is None:
                verified = plan(planner, context, start - turns, request.goal, motion)
            else:
                verified = group.plan(planner, context, start - turns, request.goal, motion)
            return context.scene.revision, verified.shifted(turns), context.timer.timings()

        revision, verified, timings = self._scheduler.run(
            work, requester(), request.timeout or settings.timeout, request.request_id
        )
        tips = group.names if group is not None else ()
        return self._reply(revision, verified, timings, openings, tip=self._tip(tips, verified))

    def _limits(self, velocity_scale: float, acceleration_scale: float) -> Limits:
        """The limits at these scales, or lower ones in a stale voxel map."""
        if self._model.robot.descriptor.stale_map == "slow" and (stale := self.map_health.problem) is not None:
            log.warning("plans are slow scale=%g reason=%s", STALE_SCALE, stale)
            velocity_scale, acceleration_scale = min(velocity_scale, STALE_SCALE), min(acceleration_scale, STALE_SCALE)
        return self._scaled(velocity_scale, acceleration_scale)

    def _check_scene(self) -> None:
        """Raises Unavailable while the scene or the voxel map is not what is there."""
        if self._store.lost is not None:
            raise Unavailable(self._store.lost)
        if self._model.robot.descriptor.stale_map == "refuse":
            self.map_health.check()

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
    ) -> Plan:
        model, trajectory = self._model, verified.trajectory
        return Plan.model_construct(  # from values just verified
            plan_id=f"p-{secrets.token_hex(4)}",
            robot=self._name,
            robot_hash=model.robot.hash,
            scene_revision=revision,
            trajectory=trajectory.message(model.robot.descriptor.joints),
            tip=tip,
            selected_goal_index=verified.goal_pose,
            goal_deviation=verified.deviation,
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

    def _tip(self, groups: Sequence[str], verified: Verified) -> Pose:
        """Where the tip of the first of these groups is at the end of a motion; without groups, the robot's tip."""
        return pose_of(self._model.fk_link(self._model.robot.tip_of(groups), verified.trajectory.position[-1]))

    def _with_ways(self, request: PlanRequest) -> Plan:
        """A goal with an approach or a retreat is a program of several motions."""
        if request.start_state is not None or constrains(request.path_constraint):
            field = "start_state" if request.start_state is not None else "path_constraint"
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
        settings = self._settings
        self._check_scene()

        def work(deadline: Deadline) -> tuple[ProgramStage, PlannedProgram, Array]:
            start = within_range(self._model, self._measured() if request.start is None else request.start, "start")
            turns = whole_turns(start, self._model.continuous)
            stage = ProgramStage(
                self._model, self._store, self.scenes, self._limits, settings, request, deadline, self.grippers
            )
            planned = plan_program(
                stage, start - turns, request.segments, self._planners, deadline.check, partial=request.partial
            )
            return stage, planned, turns

        stage, planned, turns = self._scheduler.run(
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
            tip=self._tip(planned.groups, planned.verified),
        )
        changes = tuple(
            (at, change.model_copy(update={"joints": tuple((q + turns).tolist())})) for at, change, q in planned.changes
        )
        return plan, changes

    def planner_name(self, request: PlanRequest) -> str:
        """The name of the planner that takes a request, or would by default. Raises InvalidRequest."""
        try:
            planner = self._choose(request)
        except InvalidRequest:
            planner = self._choose(request.model_copy(update={"planner": AUTO}))
        return planner.names[request.goal.kind]

    def _choose(self, request: PlanRequest) -> Planner:
        name = request.planner or self._settings.planner
        moving = request.start_state is not None
        return choose(name, request.goal, constrains(request.path_constraint), moving, self._planners)

    def cancel(self, request: CancelPlan) -> CancelledPlan:
        """Cancel the planning of a request, even one still on its way here."""
        return CancelledPlan(was_running=self._scheduler.cancel(request.request_id))

    def leave(self, client: str) -> None:
        """End all work for a client that can no longer be answered."""
        self._scheduler.leave(client)

    def ik(self, request: IkRequest) -> IkSolutions:
        """Joints for poses. Raises InvalidRequest."""
        model = self._model
        near = self._measured_or_home() if request.near is None else checked(model, request.near, "near")
        group = Group.of_tip(model.robot, request.group)
        poses = np.array([matrix(pose.position, pose.orientation) for pose in request.poses])

        def work(deadline: Deadline) -> IkSolutions:
            scene = self.scenes.present(self._settings.margin, openings=self.grippers.present())
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

        return self._scheduler.run(work, requester(), _BATCH_TIMEOUT)

    def fk(self, request: FkRequest) -> FkPoses:
        """Poses for joints. Raises InvalidRequest."""
        joints = np.array([checked(self._model, q, f"joints.{i}") for i, q in enumerate(request.joints)])
        group = Group.of_tip(self._model.robot, request.group)
        if group is None:
            poses = batch_fk(self._model, joints, request.device)
        else:
            poses = self._model.fk_link(self._model.robot.tip_of(group.names), joints)
        return FkPoses(poses=tuple(pose_of(pose) for pose in poses))

    def check(self, request: CheckRequest) -> CheckResults:
        """Exact distances of configurations. Raises InvalidRequest, or ExecutionRefused if nothing is measured."""
        model = self._model
        if request.joints is None:
            joints = [self._measured()]
        else:
            joints = [checked(model, q, f"joints.{i}") for i, q in enumerate(request.joints)]

        def work(deadline: Deadline) -> CheckResults:
            openings = self.grippers.present()
            scene, results = self.scenes.present(self._settings.margin, openings=openings), []
            whole = model.with_attached((), (), openings) if request.spheres else model
            for q in joints:
                deadline.check()
                nearest = scene.exact.nearest(q, deadline.check)
                spheres = tuple(sphere_distances(whole, scene.world, q).tolist()) if request.spheres else None
                points = scene.exact.nearest_points(q, nearest) if request.points else None
                dynamics = scene.exact.model.dynamics if request.torque else None
                results.append(
                    CheckResult(
                        in_collision=nearest.distance <= 0.0,
                        within_limits=bool(np.all((q >= model.lower) & (q <= model.upper))),
                        clearance=nearest.distance,
                        pair=nearest.pair,
                        spheres=spheres,
                        points=None if points is None else _two(points),
                        holding=None if dynamics is None else _holding(dynamics, q),
                    )
                )
            return CheckResults(results=tuple(results))

        return self._scheduler.run(work, requester(), _BATCH_TIMEOUT)

    def occupancy(self, request: OccupancyRequest) -> Occupancy:
        """The cells of a grid that the scene's objects reach into. Raises InvalidRequest if there are too many."""

        def work(deadline: Deadline) -> Occupancy:
            scene = self.scenes.present(self._settings.margin)
            cells = reached_cells(scene.world, request.resolution, deadline.check)
            return Occupancy.model_construct(  # its cells were just counted, and validation is slower
                scene_revision=scene.revision,
                resolution=request.resolution,
                cells=tuple(map(tuple, cells.tolist())),
            )

        return self._scheduler.run(work, requester(), _BATCH_TIMEOUT)

    def edit(self, request: SceneEdit) -> Scene:
        """Apply an edit of the scene and return the result.

        Raises InvalidRequest for a faulty edit, ExecutionRefused if it needs joints and nothing is measured, and
        Unavailable if it cannot be saved; then nothing has changed.
        """
        match request.edit:
            case SetLinkCollision(names=names, enabled=enabled):
                check_links(self._model.links, names, "edit.names")
                if not enabled and {*self._model.links} <= {*names, *self._store.scene.ignored_links}:
                    raise InvalidRequest(
                        "this would turn off collision checking for every link; keep at least one",
                        field="edit.names",
                    )
            case AttachObject(name=name, touch_links=touch_links):
                check_attach(self._model.links, name, touch_links, "edit")
        if not isinstance(request.edit, AttachObject | DetachObject):
            return self._store.edit(request, prepare=self.scenes.prepare)
        given = request.edit.joints
        q = self._measured() if given is None else checked(self._model, given, "edit.joints")
        openings = self.grippers.present()
        edit = request.edit
        return self._store.edit(
            request,
            lambda scene: self._model.fk_link(carrier(self._model, scene, edit), q),
            lambda scene: self.scenes.prepare(scene, openings),
        )

    def planners(self) -> Planners:
        """The planners that a request may name."""
        return Planners(names=names_of(self._planners))

    def change_settings(self, change: SettingsChange) -> PlannerSettings:
        """Apply all changes at once, and return all settings. Raises InvalidRequest."""
        if change.planner is not None:
            check_name(change.planner, self._planners)
        with self._lock:
            self._settings = self._settings.model_copy(update=change.model_dump(exclude_none=True))
            return self._settings

    def _measured_or_home(self) -> Array:
        try:
            return self._measured()
        except ExecutionRefused:
            return np.array(self._model.robot.descriptor.home)


def _holding(dynamics: Dynamics, q: Array) -> tuple[HoldingTorque, ...]:
    """The torques that hold the robot at joints (dof,)."""
    torques, efforts = dynamics.holding(q[None])[0].tolist(), dynamics.limit.tolist()
    return tuple(
        HoldingTorque(torque=torque, effort=effort if math.isfinite(effort) else None)
        for torque, effort in zip(torques, efforts, strict=True)
    )


def _two(points: NDArray[np.float64]) -> tuple[Vector3, Vector3]:
    """Two points (2, 3) in their message form."""
    (ax, ay, az), (bx, by, bz) = points.tolist()
    return (ax, ay, az), (bx, by, bz)
