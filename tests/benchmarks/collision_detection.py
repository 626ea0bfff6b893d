"""Collisions felt by the efforts of the joints: `python tests/benchmarks/collision_detection.py [--minutes 60] [--pushes 300] [--force 50]`.

A UR5e with mass and the `industrial` drives (friction, noise, delay) goes from one random configuration to the next, in simulated time. First the joints are
identified, and its limits set, as `zarm identify` does after some minutes of motion; with --links-alone, the limits alone. Then it moves for an hour, and every collision that is
felt while the arm touches nothing is a false alarm. At last, in each motion a force in a random direction pushes the tip from a random moment on. It is noticed if a joint state within
the time given leads to the message that stops the robot; the time counts from the push. A force that no joint bears with more than its limit, such as
one along the arm, cannot be noticed and is counted apart.
"""

from __future__ import annotations

import argparse
import logging
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path

from zarm_trajectory.arrays import Array

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from rich.console import Console
from rich.table import Table

from zarm_cli.identify import limits as suggested_limits
from zarm_contract.descriptor import StatedJointDynamics
from zarm_contract.errors import ZarmError
from zarm_contract.messages import ExecutorState, ExternalTorque, JointGoal, JointState, PlanRequest
from zarm_contract.robot import RobotDescription, load_robot
from zarm_geometry.robot_model import RobotModel
from zarm_physics_sim.arm import PhysicalArm
from zarm_physics_sim.drives import PRESETS
from zarm_physics_sim.simulation import Simulation
from zarm_physics_sim.world import World
from zarm_planner.handlers import Handlers
from zarm_planner.scene.store import SceneStore
from zarm_servo.guarding.collision_detection import CollisionDetection
from zarm_servo.world.scene_monitor import SceneMonitor
from zarm_simulated_driver.player import STEP, TICK
from zarm_trajectory.trajectory import TimedTrajectory

ROBOT = load_robot("ur5e")
SPARE = 1.5
"""Factor from the largest difference seen to the limit, without what the joints need."""
LEARNING = 5.0
"""Minutes of motion from which the limits come."""
LOOKED = 0.3
"""How long (s) a push lasts."""
SETTLING = 500
"""Steps after the arm was put elsewhere."""
ATTEMPTS = 50
"""Goals that are tried from one place."""


class Cell:
    """The arm, in simulated time, and what is felt."""

    def __init__(self, folder: Path, seed: int) -> None:
        self.handlers = Handlers(RobotModel.of(ROBOT), "felt", SceneStore(folder), lambda: self.position)
        self.handlers.warm_up(lambda _: None)
        home = np.array(ROBOT.descriptor.home)
        simulation = Simulation(ROBOT, World(), home)
        self.arm = PhysicalArm(simulation, PRESETS["industrial"], range(len(home)), seed, lambda _: None)
        self.rng = np.random.default_rng(seed)
        self.time = 0.0
        self.felt: list[ExternalTorque] = []
        self.largest = np.zeros(len(home))
        self.detection = self.detecting(ROBOT)
        self.numbers = count()

    @property
    def position(self) -> tuple[float, ...]:
        return tuple(self.arm.simulation.position.tolist())

    def detecting(self, robot: RobotDescription) -> CollisionDetection:
        """The detection of collisions of a robot."""
        return CollisionDetection(RobotModel.of(robot), SceneMonitor(lambda: None), self._receive, lambda: None)

    def _receive(self, message: ExternalTorque) -> None:
        self.largest = np.maximum(self.largest, message.largest)
        if message.joint is not None:
            self.felt.append(message)

    def motion(self) -> Iterator[None]:
        """Each step of a motion to a random configuration."""
        path = self._planned()
        self.detection.on_state(
            ExecutorState(
                mode="running",
                strategy="joint_trajectory",
                goal_id=f"goal-{next(self.numbers)}",
                speed_scale=1.0,
                missed_ticks=0,
            )
        )
        positions, velocities, _ = path.sample(np.append(np.arange(TICK, path.duration, TICK), path.duration))
        self.arm.play(positions, velocities)
        for _ in range(round((path.duration + 0.5) / STEP)):
            self.step()
            yield

    def step(self) -> None:
        self.arm.step()
        self.time += STEP
        self.detection.on_joints(
            "",
            JointState(
                stamp=self.time,
                joint_names=ROBOT.descriptor.joints,
                position=tuple(self.arm.position.tolist()),
                velocity=tuple(self.arm.velocity.tolist()),
                effort=tuple(self.arm.effort.tolist()),
            ),
        )

    def _planned(self) -> TimedTrajectory:
        attempts = 0
        while True:
            attempts += 1
            if attempts == ATTEMPTS:  # it rests too near to itself to be planned for
                self.arm.displace(np.subtract(ROBOT.descriptor.home, self.position))
                for _ in range(SETTLING):
                    self.arm.step()
                self.time += 1.0
            goal = tuple(self.rng.uniform([-3, -2.6, -2.2, -3, -3, -3], [3, -0.5, 2.2, 3, 3, 3]).tolist())
            try:
                plan = self.handlers.plan(
                    PlanRequest(goal=JointGoal(kind="joints", position=goal), start=self.position)
                )
            except ZarmError:
                continue
            return TimedTrajectory.of(plan.trajectory, ROBOT.descriptor.joints)


def described(limits: Array, joints: StatedJointDynamics | None) -> RobotDescription:
    """The robot with these limits (J,), and what its joints need."""
    known = {"external_torque_limits": tuple(limits.tolist()), "joint_dynamics": joints}
    execution = ROBOT.descriptor.execution.model_copy(update=known)
    return replace(ROBOT, descriptor=ROBOT.descriptor.model_copy(update={"execution": execution}))


def moving(cell: Cell, minutes: float) -> tuple[int, int]:
    """Move for this long; returns in how many motions a collision was felt though nothing touched, and in how many the arm touched itself."""
    alarms, touches, end = 0, 0, cell.time + 60.0 * minutes
    while cell.time < end:
        cell.felt.clear()
        touched = False
        for _ in cell.motion():
            touched = touched or any(cell.arm.simulation.contacts())
        alarms += bool(cell.felt) and not touched
        touches += touched
    return alarms, touches


def pushed(cell: Cell, limits: Array, force: float) -> tuple[float | None, bool]:
    """After how long (s) a push in a motion was noticed, and whether a joint had to bear more than its limit."""
    direction = cell.rng.normal(size=3)
    wrench = force * direction / np.linalg.norm(direction)
    steps = cell.motion()
    for _ in range(int(cell.rng.integers(10, 80))):
        next(steps, None)
    jacobian = RobotModel.of(ROBOT).tip_jacobian(cell.arm.simulation.position)
    noticeable = bool(np.any(np.abs(jacobian[:3].T @ wrench) > limits))
    cell.felt.clear()
    cell.arm.push(tuple(wrench.tolist()))
    began, after = cell.time, None
    while cell.time < began + LOOKED and after is None:
        cell.step()
        after = cell.time - began if cell.felt else None
    cell.arm.push(None)
    for _ in range(200):
        cell.step()
    cell.arm.play(cell.arm.position[None], np.zeros((1, len(limits))))
    for _ in range(100):
        cell.step()
    return after, noticeable


def main() -> None:
    """Print the tables."""
    logging.disable()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--pushes", type=int, default=300)
    parser.add_argument("--force", type=float, default=50.0, help="N")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--links-alone", action="store_true", help="what the joints need counts as torque from outside")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        cell = Cell(Path(name), arguments.seed)
        moving(cell, LEARNING)
        found = cell.detection.identification.found()
        if arguments.links_alone:
            known, limits = None, SPARE * cell.largest
        else:
            known = StatedJointDynamics(friction=found.friction, damping=found.damping, armature=found.armature)
            limits = np.array(suggested_limits(found))
        cell.largest = np.zeros(len(limits))
        cell.detection = cell.detecting(described(limits, known))
        alarms, touches = moving(cell, arguments.minutes)
        joints = Table("joint", "friction", "damping", "armature", "limit", "largest in motion (Nm)")
        for k, joint in enumerate(ROBOT.descriptor.joints):
            terms = (found.friction[k], found.damping[k], found.armature[k], limits[k], cell.largest[k])
            joints.add_row(joint, *(f"{term:.2f}" for term in terms))
        pushes = [pushed(cell, limits, arguments.force) for _ in range(arguments.pushes)]
    times = np.array([after for after, noticeable in pushes if noticeable and after is not None])
    noticeable = sum(each for _, each in pushes)
    table = Table("what", "figure")
    table.add_row(f"false alarms in {arguments.minutes:g} min of motion", str(alarms))
    table.add_row("motions in which the arm touched itself", str(touches))
    table.add_row(
        f"pushes with {arguments.force:g} N that a joint bears with more than its limit",
        f"{noticeable} of {len(pushes)}",
    )
    table.add_row("of these noticed within 30 ms", f"{int((times <= 0.03 + 1e-9).sum())}")
    table.add_row("noticed within 50 ms, 300 ms", f"{int((times <= 0.05 + 1e-9).sum())}, {len(times)}")
    table.add_row("noticed after, median and last", f"{1e3 * np.median(times):.0f} ms, {1e3 * times.max():.0f} ms")
    Console().print(joints, table)


if __name__ == "__main__":
    main()
