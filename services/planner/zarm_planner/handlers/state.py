"""What the handlers share: the robot, its scene, the settings, and who works when."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable, Sequence
from functools import lru_cache, partial

import numpy as np

from zarm_contract.errors import ExecutionRefused, Unavailable
from zarm_contract.messages import GripperState, Planners, PlannerSettings, PlanRequest, SettingsChange
from zarm_geometry.gripper_openings import GripperOpenings
from zarm_geometry.robot_model import RobotModel
from zarm_planner.constraints.path_constraint import constrains
from zarm_planner.planners.base import Planner
from zarm_planner.planners.registry import check_name, choose, names_of
from zarm_planner.scene.map_health import STALE_SCALE, MapHealth
from zarm_planner.scene.scene_cache import SceneCache
from zarm_planner.scene.store import SceneStore
from zarm_planner.scheduler import Scheduler
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits

log = logging.getLogger(__name__)

BATCH_TIMEOUT = 60.0
"""Time limit (s) for a batch of kinematics or checks."""


class PlannerState:
    """The state of one robot's planner, for any number of threads. Its fields are those of `Handlers`; `grippers` are as measured."""

    def __init__(
        self,
        model: RobotModel,
        name: str,
        store: SceneStore,
        measured: Callable[[], Array],
        is_there: Callable[[str], bool],
        planners: Sequence[Planner],
        gripper_state: Callable[[str], GripperState | None],
    ) -> None:
        self.model, self.name, self.store, self.measured = model, name, store, measured
        self.grippers = GripperOpenings(model.robot.descriptor, ask=gripper_state)
        self.planners = planners
        self.scenes = SceneCache(model, store)
        self.scheduler = Scheduler(os.cpu_count() or 1, is_there)
        self.map_health = MapHealth()
        self.settings = PlannerSettings()
        self._changing = threading.Lock()
        self._scaled = lru_cache(maxsize=16)(
            partial(Limits.of, model.robot)
        )  # by the scales of velocity and acceleration

    def change_settings(self, change: SettingsChange) -> PlannerSettings:
        """Apply all changes at once, and return all settings. Raises InvalidRequest."""
        if change.planner is not None:
            check_name(change.planner, self.planners)
        with self._changing:
            self.settings = self.settings.model_copy(update=change.model_dump(exclude_none=True))
            return self.settings

    def planner_names(self) -> Planners:
        """The planners that a request may name."""
        return Planners(names=names_of(self.planners))

    def choose(self, request: PlanRequest) -> Planner:
        """The planner that takes a request. Raises InvalidRequest."""
        name = request.planner or self.settings.planner
        moving = request.start_state is not None
        return choose(name, request.goal, constrains(request.path_constraint), moving, self.planners)

    def limits(self, velocity_scale: float, acceleration_scale: float) -> Limits:
        """The limits at these scales, or lower ones in a stale voxel map."""
        if self.model.robot.descriptor.stale_map == "slow" and (stale := self.map_health.problem) is not None:
            log.warning("plans are slow scale=%g reason=%s", STALE_SCALE, stale)
            velocity_scale, acceleration_scale = min(velocity_scale, STALE_SCALE), min(acceleration_scale, STALE_SCALE)
        return self._scaled(velocity_scale, acceleration_scale)

    def check_scene(self) -> None:
        """Raises Unavailable while the scene or the voxel map is not what is there."""
        if self.store.lost is not None:
            raise Unavailable(self.store.lost)
        if self.model.robot.descriptor.stale_map == "refuse":
            self.map_health.check()

    def measured_or_home(self) -> Array:
        """The measured joints (dof,); where nothing is measured, home."""
        try:
            return self.measured()
        except ExecutionRefused:
            return np.array(self.model.robot.descriptor.home)
