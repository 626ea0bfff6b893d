"""Stops of a robot with mass: `python tests/benchmarks/stops_with_mass.py [--stops 20] [--seed 0]`.

Planner, executor, servo and physics as processes, a row for each preset of drives: the M1013 goes from one random configuration to the
next at full speed. Where its links are going to be, 0.8 to 1.5 s ahead, a ball appears, and the servo stops the robot before it. Of the
stops that can avoid contact, from the true joints until the robot rests, by python-fcl:

- `distance`: the least distance to the ball, median and least (mm); the servo keeps 20 mm if it can;
- `lag`: how much later than its commands the robot was, as the executor reported it, median and greatest (ms).
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from contextlib import ExitStack, suppress
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from rich.console import Console
from rich.table import Table

from support.executor.client import Client
from support.harness import ServiceProcess, eventually, router
from support.planner.client import load, plan, to_joints
from support.planner.second_opinion import Clearance, Collisions, link_pose
from support.trajectories import KEYS, ROBOT, with_execution
from zarm_contract.errors import ZarmError
from zarm_contract.messages import (
    AddObjects,
    GoalState,
    PhysicsState,
    Plan,
    PlanRequest,
    RemoveObjects,
    SceneEdit,
    Sphere,
)
from zarm_runtime.bus import Bus
from zarm_trajectory.trajectory import TimedTrajectory

LINKS = tuple(ROBOT.descriptor.collision)[-4:]
DRIVES = (
    ("ideal", "joint_trajectory"),
    ("industrial", "joint_trajectory"),
    ("industrial", "joint_speed"),
    ("m1013", "joint_speed"),
    ("m1013", "joint_trajectory"),
    ("hobby", "joint_trajectory"),
)
LONGEST = 20.0


class Stops:
    """Stops of one robot, whose truth is known."""

    def __init__(self, bus: Bus, seed: int) -> None:
        self.bus, self.client = bus, Client(bus)
        self.random = np.random.default_rng(seed)
        self.truth: list[PhysicsState] = []
        self.distances: list[float] = []
        self.unavoidable = self.failed = 0
        bus.subscribe(KEYS.physics_state, lambda _, state: self.truth.append(state))

    def stop(self) -> None:
        """A motion, and a stop on its way if there is time for one."""
        made = self._plan()
        if made is None:
            return
        path = TimedTrajectory.of(made.trajectory, ROBOT.descriptor.joints)
        try:
            goal = self.client.execute(plan_id=made.plan_id)
            self.client.under_way(goal, self.random.uniform(0.1, 0.3))
            ball = self._ball(path)
            self._edit(AddObjects(op="add", objects=(ball,)))
            answered = time.time()
            eventually(lambda: self._rests(goal), "the robot rests", LONGEST)
            hold = self._newest(goal).hold
            if hold is not None and hold.obstruction is not None:
                self._judge(ball, answered, avoidable=hold.obstruction.avoidable)
            self._edit(RemoveObjects(op="remove", names=("ball",)))
            self.failed += self.client.ended(goal).status != "succeeded"
        except ZarmError:
            self.failed += 1
        load(self.bus)
        if self.client.state().mode == "fault":
            self.client.command(KEYS.reset)

    def _plan(self) -> Plan | None:
        wide = self.random.uniform(-1.3, 1.3, len(ROBOT.descriptor.joints))
        goal = np.array(ROBOT.descriptor.home) + wide
        with suppress(ZarmError):
            made = plan(self.bus, PlanRequest(goal=to_joints(*goal.tolist())))
            return made if made.trajectory.time[-1] > 2.0 else None
        return None

    def _ball(self, path: TimedTrajectory) -> Sphere:
        while True:
            present = np.array(self.client.measured[-1].position)
            ahead = path.nearest(present, 0.0, path.duration) + self.random.uniform(0.8, 1.5)
            link = link_pose(ROBOT, str(self.random.choice(LINKS)), path.at(min(ahead, path.duration))[0])
            ball = Sphere(kind="sphere", name="ball", position=tuple(link[:3, 3].tolist()), radius=0.06)
            if not Collisions(ROBOT, [ball]).at(present):
                return ball

    def _edit(self, edit: AddObjects | RemoveObjects) -> None:
        self.bus.call(KEYS.scene_edit, SceneEdit(edit=edit), timeout=20)

    def _newest(self, goal: str) -> GoalState:
        return next(state for state in reversed(self.client.goals) if state.goal_id == goal)

    def _rests(self, goal: str) -> bool:
        state, moved = self._newest(goal), np.array([each.position for each in self.truth[-15:]])
        return state.done or (state.hold is not None and bool(np.ptp(moved, axis=0).max() < 1e-3))

    def _judge(self, ball: Sphere, answered: float, *, avoidable: bool) -> None:
        if not avoidable:
            self.unavoidable += 1
            return
        clearance = Clearance(ROBOT, ball)
        truth = [state for state in list(self.truth) if state.stamp >= answered]
        self.distances.append(min(clearance.at(state.position, ball.position) for state in truth))


def measured(preset: str, strategy: str, stops: int, seed: int) -> list[str]:
    """A row of the table."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        endpoint = stack.enter_context(router())
        bus = stack.enter_context(Bus(endpoint))
        execution = "guard_timeout: 2.0, obstruction_timeout: 30.0, path_tolerance: 0.3, goal_tolerance: 0.1"
        robot = str(with_execution(folder / "robot", execution))
        services = {
            "physics_sim": ("--drives", preset),
            "planner": (),
            "executor": ("--strategy", strategy),
            "servo": (),
        }
        for service, arguments in services.items():
            process = ServiceProcess(service, endpoint, folder, robot, arguments=arguments)
            stack.enter_context(process).wait_ready(bus, KEYS)
        runs = Stops(bus, seed)
        while len(runs.distances) < stops:
            runs.stop()
        distance = 1e3 * np.array(runs.distances)
        lag = 1e3 * np.array([state.lag for state in runs.client.goals if state.lag is not None])
        return [
            preset, strategy, str(len(distance)), f"{np.median(distance):.1f} / {distance.min():.1f}",
            str((distance <= 0.0).sum()), str(runs.unavoidable), str(runs.failed), f"{np.median(lag):.0f} / {lag.max():.0f}",
        ]  # fmt: skip


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--stops", type=int, default=20, help="per row")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    table = Table("drives", "strategy", "stops", "distance", "contacts", "unavoidable", "failed", "lag")
    for preset, strategy in DRIVES:
        row = measured(preset, strategy, arguments.stops, arguments.seed)
        Console(stderr=True).print(*row)
        table.add_row(*row)
    Console(width=160).print(table)


if __name__ == "__main__":
    main()
