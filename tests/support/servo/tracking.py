"""A session without a bus: the controller and the local goal of the servo, with a planner in the same process that
answers at once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from zarm_contract.messages import LoadScene, SceneEdit, SceneObject
from zarm_geometry.motion_check import MotionCheck
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.handlers import Handlers
from zarm_planner.scene.store import SceneStore
from zarm_servo.tracking.controller import Controller, Step
from zarm_servo.tracking.global_plan import GlobalPlan, find_global_plan
from zarm_servo.tracking.local_goal import LocalGoal
from zarm_servo.tracking.session import soft
from zarm_servo.tracking.targets import JointTarget, PoseTarget
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits

T = TypeVar("T")


class AtOnce(Executor):
    """Runs its task before it returns."""

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        done: Future[T] = Future()
        try:
            done.set_result(fn(*args, **kwargs))
        except Exception as error:
            done.set_exception(error)
        return done


def planner_in(model: RobotModel, name: str, folder: Path, objects: Sequence[SceneObject]) -> Handlers:
    """A planner with these objects in its scene; its state is in `folder`."""
    store = SceneStore(folder)
    planner = Handlers(model, name, store, lambda: np.array(model.robot.descriptor.home))
    store.edit(SceneEdit(edit=LoadScene(op="load", objects=tuple(objects))))
    return planner


class Tracker:
    """A robot led from rest at `start` (J,), `margin` (m) away from `objects`, with plans of `planner`."""

    def __init__(
        self, model: RobotModel, objects: Sequence[SceneObject], planner: Handlers, start: Array, margin: float
    ) -> None:
        self._motions = MotionCheck(model)
        self._motions.set_world(World(list(objects), 0.0))
        self._margin, joints = margin, model.robot.descriptor.joints

        def find(target: PoseTarget | JointTarget, start: Array, distance: float, timeout: float) -> GlobalPlan:
            return find_global_plan(
                lambda request, _: planner.plan(request), joints, margin, target, start, distance, timeout
            )

        self.local_goal = LocalGoal(model, find, self._free, AtOnce())
        self.controller = Controller(model, self._motions, soft(Limits.of(model.robot)), start, margin=margin)

    def step(self, target: PoseTarget | JointTarget) -> Step:
        """Advance by one PERIOD."""
        return self.controller.step(self.local_goal.target(target, self.controller.state[0], None), 0.0)

    def _free(self, start: Array, end: Array) -> bool:
        count = 2 + int(np.abs(end - start).max() / 0.05)
        way = np.linspace(start, end, count)
        return self._motions.check(
            np.arange(float(count)), way, margin=self._margin, acceleration=np.zeros(len(start))
        ).free
