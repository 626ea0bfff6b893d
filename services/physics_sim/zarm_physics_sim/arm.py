"""The arm with mass: its drives follow what a player makes of the commands."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from zarm_contract.gripper import Gripper
from zarm_contract.messages import Attached, DriverGripperCommand, Vector3
from zarm_physics_sim.drives import Drives, DriveSettings
from zarm_physics_sim.simulation import STEP, Simulation
from zarm_physics_sim.world import World
from zarm_runtime import clock
from zarm_simulated_driver import player
from zarm_simulated_driver.player import Player
from zarm_trajectory.arrays import Array

_STEPS = round(player.STEP / STEP)
_STEPS_PER_REPORT = 2
"""A report is made at every this many steps of the player."""
_FINGER_GAIN = 7500.0
"""Force of a gripper's drive per distance of the opening from the commanded one (N/m), up to the commanded force ..."""
_FINGER_DAMPING = 30.0
"""... and its damping (N s/m)."""


@dataclass
class GripperDrive:
    """The drive of one gripper: its joint goes to `target` at `speed` (rad/s, m/s), the fingers press with at most `force` (N)."""

    gripper: Gripper
    target: float
    reference: float
    speed: float
    force: float
    command: DriverGripperCommand | None = field(default=None)


class PhysicalArm:
    """The arm of a simulation, whose joints are numbered as in the driver; `order` (J,) gives the descriptor's number of
    each. `report` gets the simulation 50 times a second. Another thread may replace the world.
    """

    def __init__(
        self,
        simulation: Simulation,
        settings: DriveSettings,
        order: Sequence[int],
        seed: int,
        report: Callable[[Simulation], None],
    ) -> None:
        self._simulation, self._order = simulation, np.array(order)
        self._square = np.ix_(self._order, self._order)
        self._report, self._steps = report, 0
        self._lock = threading.Lock()
        start = simulation.position[self._order]
        self._player = Player(start, plays=settings.plays, ceiling=math.radians(settings.ceiling), lag=settings.lag)
        self._drives = Drives(settings, simulation.limit[self._order], STEP, np.random.default_rng(seed))
        simulation.set_friction(settings.friction * simulation.largest, settings.viscous * simulation.largest)
        self.grippers = {
            name: GripperDrive(
                gripper,
                gripper.positions[-1],
                gripper.positions[-1],
                gripper.joint_speed * gripper.speed,
                gripper.force,
            )
            for name, gripper in simulation.robot.descriptor.grippers.items()
        }
        self._finger_scales = [
            (finger.stiffness(simulation.robot), finger.force(simulation.robot)) for finger in simulation.fingers
        ]
        self._measured: tuple[Array, Array] = start, np.zeros(len(start))
        self._effort: Array = simulation.bias[self._order]
        self._push: Vector3 | None = None

    @property
    def simulation(self) -> Simulation:
        """The present simulation."""
        return self._simulation

    @property
    def position(self) -> Array:
        """Measured positions (J,), rad."""
        return self._measured[0]

    @property
    def velocity(self) -> Array:
        """Measured velocities (J,), rad/s."""
        return self._measured[1]

    @property
    def effort(self) -> Array:
        """Mean torques (J,) of the drives in the last step, Nm."""
        return self._effort

    @property
    def played(self) -> int:
        """How many points of the last command are played."""
        return self._player.played

    @property
    def total(self) -> int:
        """How many points the last command had."""
        return self._player.total

    def play(self, positions: Array, velocities: Array) -> int:
        """Play these points, see `Player.play`."""
        return self._player.play(positions, velocities)

    def displace(self, offset: Array) -> None:
        """Be elsewhere at once, at rest, by `offset` (J,) rad."""
        self._player.displace(offset)
        with self._lock:
            moved = self._simulation.position
            moved[self._order] += offset
            self._simulation.place(moved)

    def push(self, force: Vector3 | None) -> None:
        """From now on push the tip with this force (N, base frame)."""
        self._push = force

    def step(self, *, stalled: bool = False) -> None:
        """Let `player.STEP` seconds pass; see `Player.step`."""
        before = self._player.position, self._player.velocity
        self._player.step(stalled=stalled)
        acceleration = (self._player.velocity - before[1]) / player.STEP
        effort = np.zeros(len(self._order))
        with self._lock:
            for k in range(1, _STEPS + 1):
                passed = k * STEP
                speed = before[1] + acceleration * passed
                place = before[0] + (before[1] + 0.5 * acceleration * passed) * passed
                effort += self._substep((place, speed, acceleration))
            self._effort = effort / _STEPS
            self._steps += 1
            if self._steps % _STEPS_PER_REPORT == 0:
                self._report(self._simulation)

    def _substep(self, reference: tuple[Array, Array, Array]) -> Array:
        """One step of the simulation; returns the torques (J,) of the drives."""
        simulation, order = self._simulation, self._order
        self._measured = self._drives.measured(simulation.position[order], simulation.velocity[order])
        driven = self._drives.torque(reference, self._measured, simulation.mass[self._square], simulation.bias[order])
        torque = np.empty(len(order))
        torque[order] = driven
        simulation.step(torque, self._finger_forces(), self._push)
        return driven

    def _finger_forces(self) -> Array:
        simulation = self._simulation
        if not simulation.fingers:
            return np.zeros(0)
        for drive in self.grippers.values():
            most = drive.speed * STEP
            drive.reference += min(max(drive.target - drive.reference, -most), most)
        drives = {id(drive.gripper): drive for drive in self.grippers.values()}
        forces = np.zeros(len(simulation.fingers))
        states = zip(simulation.fingers, simulation.finger_position, simulation.finger_velocity, strict=True)
        for k, ((finger, position, velocity), (stiff, share)) in enumerate(
            zip(states, self._finger_scales, strict=True)
        ):
            drive = drives[id(finger.gripper)]
            force = stiff * (_FINGER_GAIN * (finger.at(drive.reference) - position) - _FINGER_DAMPING * velocity)
            forces[k] = min(max(force, -drive.force * share), drive.force * share)
        return forces

    def picture(self) -> tuple[Simulation, Any, float]:
        """The present simulation, a copy of its state, and the time (Unix, s)."""
        with self._lock:
            return self._simulation, self._simulation.snapshot(), clock.unix_time()

    def change_world(
        self, world: World, carried: Sequence[Attached], prepare: Callable[[Simulation], None] = lambda _: None
    ) -> None:
        """Go on in another world, once that is prepared for."""
        changed = self._simulation.in_world(world, carried)
        if changed is self._simulation:
            return
        prepare(changed)
        with self._lock:
            changed.go_on_from(self._simulation)
            self._simulation = changed
