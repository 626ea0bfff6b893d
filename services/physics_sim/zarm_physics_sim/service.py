"""The process of the physical driver."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from zarm_contract.errors import InvalidRequest
from zarm_contract.world import load_world
from zarm_physics_sim.arm import PhysicalArm
from zarm_physics_sim.cameras import ImagePublishers, SimulatedCameras
from zarm_physics_sim.drives import drive_settings
from zarm_physics_sim.hands import PhysicalHands
from zarm_physics_sim.simulation import Simulation
from zarm_physics_sim.surroundings import Surroundings
from zarm_physics_sim.truth import Truth
from zarm_physics_sim.world import World
from zarm_runtime.realtime import PROCESS_PRIORITY, ask_for_realtime
from zarm_runtime.service import Service, run_service, service_parser
from zarm_simulated_driver.axes import Axes
from zarm_simulated_driver.driving import add_options, driving, start_position

log = logging.getLogger(__name__)


@contextmanager
def start(service: Service) -> Iterator[None]:
    """The arm with mass, from its first step to its last."""
    robot, options = service.robot, service.options
    settings = drive_settings(options.drives)
    if not options.density > 0.0:
        raise InvalidRequest(f"{options.density:g} kg/m³ is no density; give a positive one", field="--density")
    world = World() if options.world is None else World.of(load_world(options.world))
    axes = Axes.of(robot.descriptor)
    order = [robot.descriptor.joints.index(name) for name in axes.names]
    at = np.empty(len(order))
    at[order] = start_position(service, axes)
    simulation = Simulation(robot, world, at, density=options.density)
    service.note = _note(simulation, options.density)
    log.info("physics %s", service.note)

    # A slow reader of images must not hold up the robot, so these have a session of their own.
    with service.open_bus() as bus, service.open_bus() as image_bus:
        truth = Truth(bus.publisher(service.keys.physics_state).put)
        arm = PhysicalArm(simulation, settings, order, options.seed, truth.report)
        cameras = SimulatedCameras(arm, ImagePublishers(image_bus, service.keys))
        surroundings = Surroundings(arm, cameras, world, bus.latched(service.keys.physics_objects).set)
        with cameras:
            bus.watch(service.keys.cameras, cameras.receive)
            bus.watch(service.keys.scene, lambda _, scene: surroundings.see(scene))
            bus.serve(service.keys.physics_world, surroundings.load)
            with driving(service, bus, axes, arm, PhysicalHands(arm)):
                yield


def _note(simulation: Simulation, density: float) -> str:
    """What the physics had to assume."""
    names = simulation.robot.descriptor.joints
    unlimited = [name for name, limit in zip(names, simulation.limit, strict=True) if np.isinf(limit)]
    parts = [*simulation.faults]
    if simulation.assumed:
        parts.append(f"inertia from geometry with {density:g} kg/m³: {', '.join(simulation.assumed)}")
    if unlimited:
        parts.append(f"torque unknown: the effort of {', '.join(unlimited)} cannot hold the arm in all of its range")
    return "; ".join(parts)


def main() -> int:
    """Run the physical driver of one robot until SIGTERM or SIGINT; the exit code."""
    parser = service_parser("physics_sim")
    add_options(parser)
    parser.add_argument(
        "--drives",
        default="industrial",
        metavar="PRESET|FILE",
        help="the drives of the joints: ideal, industrial, hobby, m1013, or a YAML file (default: industrial)",
    )
    parser.add_argument(
        "--world",
        metavar="NAME|FILE",
        help="what stands around the robot: a world that comes with zarm, or a YAML file (default: what the scene says)",
    )
    parser.add_argument(
        "--density",
        type=float,
        default=1000.0,
        metavar="KG/M3",
        help="of links whose URDF states no inertia, and of attached objects without a mass (default: 1000)",
    )
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="of the encoders' noise (default: 1)")
    ask_for_realtime(PROCESS_PRIORITY)
    return run_service("physics_sim", parser, start)


if __name__ == "__main__":
    sys.exit(main())
