"""What the planner answers: requests in, messages out, whatever carries them."""

from __future__ import annotations

import os
import secrets
import threading
from collections.abc import Callable

import numpy as np

from zarm_contract.errors import ExecutionRefused, Unavailable
from zarm_contract.messages import (
    CancelledPlan,
    CancelPlan,
    CheckRequest,
    CheckResult,
    CheckResults,
    FkPoses,
    FkRequest,
    IkRequest,
    IkSolutions,
    Plan,
    PlannerSettings,
    PlanRequest,
    SettingsChange,
)
from zarm_planner.batches import batch_fk, batch_ik
from zarm_planner.ends import Snapshot
from zarm_planner.exact import RESOLUTION, ExactScene
from zarm_planner.frames import matrix, pose_of
from zarm_planner.joints import checked, within_range
from zarm_planner.motion import Array, Limits
from zarm_planner.pipeline import Found, plan
from zarm_planner.robot_model import RobotModel
from zarm_planner.running import Running
from zarm_planner.scene import SceneStore
from zarm_planner.stop import Stop
from zarm_planner.warm_up import warm_up
from zarm_planner.world import World

_BATCH_TIMEOUT = 60.0
"""Seconds that a batch of kinematics or checks may take."""


class Planner:
    """The planner of one robot, for any number of threads. `name` is the robot's on the bus.

    `measured` returns the robot's joints (dof,) now, or raises ExecutionRefused (`no_joint_state`).
    """

    def __init__(self, model: RobotModel, name: str, store: SceneStore, measured: Callable[[], Array]) -> None:
        self._model = model
        self._name = name
        self._store = store
        self._measured = measured
        self._running = Running(os.cpu_count() or 1)
        self._lock = threading.Lock()
        self._settings = PlannerSettings()
        self._snapshot: Snapshot | None = None

    def warm_up(self, report: Callable[[str], None]) -> None:
        """Compile what plans run on, or load it; `report` is told what comes next."""
        warm_up(self._model, report)
        report("loading the scene")
        self._look()

    def close(self) -> None:
        """End all work in hand; from now on there is only Unavailable."""
        self._running.close()

    def plan(self, request: PlanRequest) -> Plan:
        """A verified motion to the goal. Raises a ZarmError that says why there is none."""
        settings, model = self._settings, self._model
        if self._store.lost is not None:
            raise Unavailable(self._store.lost)
        limits = Limits.of(
            model,
            request.velocity_scale or settings.velocity_scale,
            request.acceleration_scale or settings.acceleration_scale,
        )

        def work(stop: Stop) -> tuple[Snapshot, Found]:
            start = within_range(model, self._measured() if request.start is None else request.start, "start")
            snapshot = self._look()
            return snapshot, plan(snapshot, start, request.goal, limits, request.seed, stop)

        snapshot, found = self._running.run(work, request.timeout or settings.timeout, request.request_id)
        return Plan(
            plan_id=f"p-{secrets.token_hex(4)}",
            robot=self._name,
            robot_hash=model.robot.hash,
            scene_revision=snapshot.revision,
            trajectory=found.motion.trajectory(model.robot.descriptor.joints),
            tip=pose_of(model.fk_tip(found.motion.position[-1])),
            clearance=found.clearance,
            resolution=RESOLUTION,
            path_length=found.path_length,
            timings=found.timings,
        )

    def cancel(self, request: CancelPlan) -> CancelledPlan:
        """End the planning of a request."""
        return CancelledPlan(was_running=self._running.cancel(request.request_id))

    def ik(self, request: IkRequest) -> IkSolutions:
        """Joints for poses. Raises InvalidRequest."""
        model = self._model
        near = self._measured_or_home() if request.near is None else checked(model, request.near, "near")
        poses = np.array([matrix(pose.position, pose.orientation) for pose in request.poses])

        def work(stop: Stop) -> IkSolutions:
            snapshot = self._look()
            found = batch_ik(
                snapshot.model,
                poses,
                near,
                world=snapshot.world if request.collision_free else None,
                max_solutions=request.max_solutions,
                seed=request.seed,
                device=request.device,
                stop=stop,
            )
            return IkSolutions(solutions=tuple(tuple(map(tuple, rows.tolist())) for rows in found))

        return self._running.run(work, _BATCH_TIMEOUT)

    def fk(self, request: FkRequest) -> FkPoses:
        """Poses for joints. Raises InvalidRequest."""
        joints = np.array([checked(self._model, q, f"joints.{i}") for i, q in enumerate(request.joints)])
        poses = batch_fk(self._model, joints, request.device)
        return FkPoses(poses=tuple(pose_of(pose) for pose in poses))

    def check(self, request: CheckRequest) -> CheckResults:
        """Exact distances of configurations. Raises InvalidRequest, or ExecutionRefused where nothing is measured."""
        model = self._model
        if request.joints is None:
            joints = [self._measured()]
        else:
            joints = [checked(model, q, f"joints.{i}") for i, q in enumerate(request.joints)]

        def work(stop: Stop) -> CheckResults:
            exact, results = self._look().exact, []
            for q in joints:
                stop.check()
                nearest = exact.nearest(q)
                results.append(
                    CheckResult(
                        in_collision=nearest.distance <= 0.0,
                        within_limits=bool(np.all((q >= model.lower) & (q <= model.upper))),
                        clearance=nearest.distance,
                        pair=nearest.pair,
                    )
                )
            return CheckResults(results=tuple(results))

        return self._running.run(work, _BATCH_TIMEOUT)

    def change_settings(self, change: SettingsChange) -> PlannerSettings:
        """Apply what the change names, all of it at once, and return all settings."""
        with self._lock:
            self._settings = self._settings.model_copy(update=change.model_dump(exclude_none=True))
            return self._settings

    def _look(self) -> Snapshot:
        """The present scene, made ready for planning once per revision and margin."""
        with self._lock:
            scene, margin = self._store.scene, self._settings.margin
            ready = self._snapshot
            if ready is None or (ready.revision, ready.world.margin) != (scene.revision, margin):
                ready = Snapshot(
                    scene.revision, self._model, World(scene.objects, margin), ExactScene(self._model, scene.objects)
                )
                self._snapshot = ready
            return ready

    def _measured_or_home(self) -> Array:
        try:
            return self._measured()
        except ExecutionRefused:
            return np.array(self._model.robot.descriptor.home)
