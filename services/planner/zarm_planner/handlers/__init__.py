"""The request handlers of the planner, by kind: messages in, messages out, independent of the transport."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence

import numpy as np

from zarm_contract.errors import Unavailable
from zarm_contract.messages import CancelledPlan, CancelPlan, GripperState
from zarm_geometry.robot_model import RobotModel
from zarm_planner.handlers.checks import CheckHandlers
from zarm_planner.handlers.dynamics import DynamicsHandlers
from zarm_planner.handlers.kinematics import KinematicsHandlers
from zarm_planner.handlers.motions import MotionHandlers
from zarm_planner.handlers.scene_edits import SceneHandlers
from zarm_planner.handlers.state import PlannerState
from zarm_planner.planners.base import Planner
from zarm_planner.planners.registry import PLANNERS
from zarm_planner.scene.store import SceneStore
from zarm_planner.warm_up import warm_up
from zarm_trajectory.arrays import Array

log = logging.getLogger(__name__)


class Handlers:
    """All answers for one robot, for any number of threads, each working for its `requester`. `name` is the robot's on
    the bus.

    `measured` returns the robot's current joints (dof,), or raises ExecutionRefused (`no_joint_state`). `is_there`
    tells whether a client that had left is back. `planners` are those to choose from. `gripper_state` asks for the state of a gripper,
    and `moves` whether the robot is in motion.
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
        moves: Callable[[], bool] = lambda: False,
    ) -> None:
        state = self._state = PlannerState(model, name, store, measured, is_there, planners, gripper_state)
        self.scenes, self.grippers, self.map_health = state.scenes, state.grippers, state.map_health
        self.planners, self.change_settings = state.planner_names, state.change_settings
        motions = MotionHandlers(state)
        self.plan, self.program, self.planner_name = motions.plan, motions.program, motions.planner_name
        kinematics = KinematicsHandlers(state)
        self.ik, self.fk = kinematics.ik, kinematics.fk
        self.inverse_dynamics = DynamicsHandlers(state).inverse_dynamics
        checks = CheckHandlers(state)
        self.check, self.occupancy = checks.check, checks.occupancy
        self.edit = SceneHandlers(state, moves).edit
        self.leave = state.scheduler.leave

    def warm_up(self, report: Callable[[str], None]) -> None:
        """Compile or load the kernels used by plans; `report` is told what comes next."""
        state = self._state
        groups = state.model.robot.descriptor.groups
        one_tip = next((name for name, group in groups.items() if group.tip_link is not None), None)
        home = np.array(state.model.robot.descriptor.home)
        warm_up(state.model if one_tip is None else state.model.group((one_tip,), home), report)
        report("loading the scene")
        self.scenes.prepare(state.store.scene, self.grippers.present())
        try:
            self.scenes.present(state.settings.margin)
        except Unavailable as error:  # every plan will report this until the scene is edited
            log.error("scene cannot be used reason=%s", error)

    def cancel(self, request: CancelPlan) -> CancelledPlan:
        """Cancel the planning of a request, even one still on its way here."""
        return CancelledPlan(was_running=self._state.scheduler.cancel(request.request_id))

    def close(self) -> None:
        """End all current work; from now on there is only Unavailable."""
        self._state.scheduler.close()
