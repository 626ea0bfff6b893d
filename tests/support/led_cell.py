"""Two Pandas with an executor each, and planner and executor of both as one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np

import zarm
from support.composed import composed
from support.harness import ServiceProcess, router
from zarm_contract.keys import Keys
from zarm_contract.messages import JointState
from zarm_contract.robot import load_robot
from zarm_runtime.bus import Bus
from zarm_trajectory.arrays import Array
from zarm_trajectory.trajectory import TimedTrajectory

CELL = """
name: cell
base_link: table
parts:
  left:  {robot: panda, executor: left_arm, xyz: [0.0,  0.3, 0.0]}
  right: {robot: panda, executor: right_arm, xyz: [0.0, -0.3, 0.0]}
"""
ARMS = ("left_arm", "right_arm")


class LedCell:
    """The processes, a client for each robot, and what each arm has measured."""

    def __init__(self, stack: ExitStack, folder: Path) -> None:
        self.endpoint = stack.enter_context(router())
        self._bus = stack.enter_context(Bus(self.endpoint))
        self._stack, self._folder = stack, folder
        described = composed(folder, CELL)
        self.robot, self._described = load_robot(str(described)), str(described)
        self.seen: dict[str, list[JointState]] = {name: [] for name in ARMS}
        for name in ARMS:
            self._bus.subscribe(Keys(name).joint_states, lambda _, state, name=name: self.seen[name].append(state))
        self.arms = {name: self._started("executor", "panda", name) for name in ARMS}
        self.planner, self.executor = (
            self._started(service, self._described, "cell") for service in ("planner", "executor")
        )
        self.whole = stack.enter_context(zarm.connect(self.endpoint, "cell"))
        self.clients = {name: stack.enter_context(zarm.connect(self.endpoint, name)) for name in ARMS}

    def _started(self, service: str, robot: str, name: str) -> ServiceProcess:
        process = ServiceProcess(service, self.endpoint, self._folder, robot, name=name)
        self._stack.enter_context(process).wait_ready(self._bus, Keys(name))
        return process

    @contextmanager
    def killed(self, name: str) -> Iterator[None]:
        """A block in which the executor of an arm is gone, and after which it is back."""
        arm = self.arms[name]
        arm.process.kill()
        arm.process.wait()
        try:
            yield
        finally:
            self.arms[name] = self._started("executor", "panda", name)

    def faster_leader(self) -> ServiceProcess:
        """One more executor that would lead the arms, four times as fast as real time."""
        environment = {"ZARM_SIM_SPEED": "4"}
        return ServiceProcess(
            "executor", self.endpoint, self._folder, self._described, name="faster", environment=environment
        )

    def part(self, name: str) -> slice:
        """The joints of an arm among those of the whole."""
        return slice(7) if name == ARMS[0] else slice(7, 14)

    def off_path(self, plan: zarm.Plan) -> dict[str, float]:
        """How far (rad) each arm was from its part of a plan at most."""
        return {name: float(self._nearest(name, plan)[:, 2].max()) for name in ARMS}

    def apart(self, plan: zarm.Plan) -> Array:
        """The differences (s) between where the two arms were on their paths at the same moments, while both moved."""
        left, right = (self._nearest(name, plan) for name in ARMS)
        moving = [each[each[:, 3] > 0.2] for each in (left, right)]
        left, right = moving
        both = (left[:, 0] >= right[0, 0]) & (left[:, 0] <= right[-1, 0])
        apart: Array = left[both, 1] - np.interp(left[both, 0], right[:, 0], right[:, 1])
        return apart

    def _nearest(self, name: str, plan: zarm.Plan) -> Array:
        """For each measurement of an arm (n, 4): its stamp, the time (s) on its part of the plan, its distance from there (rad), and its speed."""
        trajectory = TimedTrajectory.of(plan.trajectory, self.robot.descriptor.joints)
        fine = np.linspace(0.0, trajectory.duration, 20_000)
        path = trajectory.positions(fine)[:, self.part(name)]
        rows = []
        for state in self.seen[name]:
            distance = np.abs(path - np.array(state.position)).max(axis=1)
            rows.append((state.stamp, fine[distance.argmin()], distance.min(), np.abs(state.velocity).max()))
        return np.array(rows)
