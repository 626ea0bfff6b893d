"""The process of the simulated driver: wires the arm to the bus, or to ROS."""

from __future__ import annotations

import logging
import math
import sys
import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from zarm_contract.errors import InvalidRequest, Unavailable
from zarm_leeloo_sim.axes import Axes
from zarm_leeloo_sim.bus_side import BusSide
from zarm_leeloo_sim.driver import LeelooDriver
from zarm_leeloo_sim.fingers import Fingers
from zarm_leeloo_sim.player import Player
from zarm_runtime.realtime import PROCESS_PRIORITY, ask_for_realtime
from zarm_runtime.service import Service, run_service, service_parser

if TYPE_CHECKING:
    from zarm_leeloo_sim.ros_side import RosSide

log = logging.getLogger(__name__)


@contextmanager
def start(service: Service) -> Iterator[None]:
    """The simulated arm, at `--at` or at the descriptor's `home`, from its first step to its last."""
    descriptor, keys, options = service.robot.descriptor, service.keys, service.options
    axes = Axes.of(descriptor)
    at = descriptor.home if options.at is None else tuple(options.at)
    if len(at) != len(descriptor.joints):
        raise InvalidRequest(
            f"{len(at)} positions for {len(descriptor.joints)} joints; give one for each", field="--at"
        )
    position = np.array([at[descriptor.joints.index(name)] for name in axes.names])
    with ExitStack() as stack:
        bus = stack.enter_context(service.open_bus())
        trace = None if options.trace is None else stack.enter_context(options.trace.open("a", buffering=1))
        side = stack.enter_context(_on_ros(service, axes)) if options.ros else BusSide(bus, keys, axes)
        driver = LeelooDriver(
            Player(position, plays=options.plays, ceiling=math.radians(options.ceiling)),
            side.publish_joints,
            (lambda _: None) if options.no_progress else side.publish_progress,
            Fingers(descriptor.grippers),
            bus.publisher(keys.driver_gripper_state).put,
            trace,
        )
        side.listen(driver.play)
        bus.subscribe(keys.driver_gripper_command, lambda _, command: driver.grip(command))
        bus.serve(keys.simulated_fault, driver.set_fault)
        ended = threading.Event()
        thread = threading.Thread(target=driver.run, args=(ended,), name="arm")
        thread.start()
        service.ready()
        try:
            yield
        finally:
            ended.set()
            thread.join()


def _on_ros(service: Service, axes: Axes) -> AbstractContextManager[RosSide]:
    """The driver's side on ROS; raises InvalidRequest and Unavailable."""
    descriptor = service.robot.descriptor
    if descriptor.strategy_params is None:
        raise InvalidRequest(
            f"{descriptor.name} names no topics; write strategy_params into its descriptor", field="--ros"
        )
    try:
        from zarm_leeloo_sim.ros_side import ros_side
    except ImportError as error:
        raise Unavailable(
            f"ROS 2 cannot be loaded ({error}); `make ros` installs it, or source an installation of ROS 2 Jazzy"
        ) from error
    return ros_side(f"{service.keys.robot}_driver", descriptor.strategy_params, axes)


def main() -> int:
    """Run the simulated driver of one robot until SIGTERM or SIGINT; the exit code."""
    parser = service_parser("leeloo_sim")
    parser.add_argument(
        "--at", type=float, nargs="+", metavar="RAD", help="joint positions at the start (default: home)"
    )
    parser.add_argument(
        "--plays",
        choices=("velocity", "position", "either"),
        default="either",
        help="which part of a point it plays; either: velocities, and positions of a command that has no velocities (default: either)",
    )
    parser.add_argument(
        "--ceiling",
        type=float,
        default=70.0,
        metavar="DEG",
        help="maximum of every joint, in deg/s and in deg/s^2 (default: 70)",
    )
    parser.add_argument("--no-progress", action="store_true", help="report no progress, like some drivers")
    parser.add_argument("--ros", action="store_true", help="use the ROS topics of the descriptor instead of the bus")
    parser.add_argument(
        "--trace", type=Path, metavar="FILE", help="append the true motion of the arm to this file, whatever it reports"
    )
    ask_for_realtime(PROCESS_PRIORITY)  # like the executor's: beside busy processes it would play its points late
    return run_service("leeloo_sim", parser, start)


if __name__ == "__main__":
    sys.exit(main())
