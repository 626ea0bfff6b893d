"""Turns a client's request into a plan, for services and actions alike."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from zarm_contract.errors import InvalidRequest, ZarmError
from zarm_contract.messages import Plan, PlanRequest, Pose
from zarm_ros_bridge.convert.fields import in_terms_of
from zarm_ros_bridge.convert.joints import is_empty, positions_of
from zarm_ros_bridge.curobo.motion_requests import MotionRequest
from zarm_ros_bridge.curobo.parameters import Parameters
from zarm_ros_bridge.engine import Engine
from zarm_runtime.publications import deliver
from zarm_trajectory.trajectory import TimedTrajectory

_READS = ("planner_type", "max_attempts", "collision_activation_distance")
"""Parameters that affect a plan."""
_FIELDS = {"start": "start_pose", "path_constraint": "trajectory_constraints"}
"""Other fields of a plan request, and their names on ROS."""


class Motions:
    """Plans according to the parameters, and remembers the last plan. Thread-safe."""

    def __init__(self, engine: Engine, parameters: Parameters) -> None:
        self._engine = engine
        self._parameters = parameters
        self._turn = threading.Lock()
        self._last: tuple[Any, Plan] | None = None
        self._cleared: str | None = None  # the id of a plan that must not be executed, or "" if it is unknown
        engine.bus.listen(engine.keys.plans, self._published)

    @property
    def planner(self) -> str:
        """The active planner."""
        name: str = self._parameters.value("planner_type")
        return name

    def plan(self, asked: MotionRequest, request_plan: Callable[[PlanRequest], Plan]) -> Plan:
        """The plan that `request_plan` returns. Raises its errors, in terms of the client's request."""
        value = self._parameters.value
        start = None if is_empty(asked.start) else positions_of(asked.start, self._engine.joints, "start_pose")
        request = PlanRequest(
            goal=asked.goal,
            start=start,
            path_constraint=asked.constraint,
            planner="auto",
            timeout=value("timeout"),
            max_attempts=value("max_attempts"),
            margin=value("collision_activation_distance"),
        )
        try:
            plan = request_plan(request)
        except ZarmError as error:
            raise in_terms_of(error, {"goal.through": asked.field, "goal": asked.field} | _FIELDS) from error
        with self._turn:
            self._last, self._cleared = (self._key(asked), plan), None
        return plan

    def made(self, asked: MotionRequest) -> Plan | None:
        """The last plan, if it was made for the same request and parameters. The executor checks whether it is still
        valid.
        """
        with self._turn:
            last = self._last
        return last[1] if last is not None and last[0] == self._key(asked) else None

    def clear(self) -> None:
        """The last plan, whoever requested it, must not be executed any more."""
        with self._turn:
            self._cleared = self._last[1].plan_id if self._last is not None else ""
            self._last = None

    def check_last(self) -> None:
        """Raises InvalidRequest if the last plan was cleared, and none has been made since."""
        with self._turn:
            if self._cleared is not None:
                raise InvalidRequest("the last plan was cleared; plan again, or give the goal a target")

    def _published(self, key: str, payload: bytes) -> None:
        if self._cleared is not None:
            deliver(key, payload, Plan, self._planned)

    def _planned(self, _: str, plan: Plan) -> None:
        """A plan was published; ignored if it is the cleared one, arriving late."""
        with self._turn:
            if plan.plan_id != self._cleared:
                self._cleared = None

    def passed(self, asked: MotionRequest, plan: Plan) -> list[int]:
        """The index of the pose passed in each goal set before the last one: the one closest to the tip at that time."""
        sets = asked.sets[:-1]
        if asked.any_set or all(len(poses) == 1 for poses in sets):
            return [0] * len(sets)
        trajectory = TimedTrajectory.of(plan.trajectory, plan.trajectory.joint_names)
        positions, _, _ = trajectory.sample(np.array(plan.waypoint_times[: len(sets)]))
        tips = self._engine.client.fk([tuple(row) for row in positions.tolist()])
        return [
            min(range(len(poses)), key=lambda i: _apart(poses[i], tip)) for poses, tip in zip(sets, tips, strict=True)
        ]

    def _key(self, asked: MotionRequest) -> Any:
        start = asked.start
        return (
            (tuple(start.name), tuple(start.position)),
            (asked.field, asked.sets, asked.any_set, asked.joints, asked.constraint),
            *(self._parameters.value(name) for name in _READS),
        )


def _apart(one: Pose, other: Pose) -> float:
    """Sum of the distance (m) and half the rotation (rad) between two poses."""
    turn = min(1.0, abs(float(np.dot(one.orientation, other.orientation))))
    return float(np.linalg.norm(np.subtract(one.position, other.position)) + np.arccos(turn))
