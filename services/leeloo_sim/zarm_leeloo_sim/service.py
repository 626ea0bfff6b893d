"""The process of the kinematic driver."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from zarm_leeloo_sim.fingers import Fingers
from zarm_runtime.realtime import PROCESS_PRIORITY, ask_for_realtime
from zarm_runtime.service import Service, run_service, service_parser
from zarm_simulated_driver.axes import Axes
from zarm_simulated_driver.driving import add_options, driving, start_position
from zarm_simulated_driver.player import Player


@contextmanager
def start(service: Service) -> Iterator[None]:
    """The simulated arm, from its first step to its last."""
    descriptor, options = service.robot.descriptor, service.options
    axes = Axes.of(descriptor)
    player = Player(start_position(service, axes), plays=options.plays, ceiling=math.radians(options.ceiling))
    with service.open_bus() as bus, driving(service, bus, axes, player, Fingers(descriptor.grippers)):
        yield


def main() -> int:
    """Run the simulated driver of one robot until SIGTERM or SIGINT; the exit code."""
    parser = service_parser("leeloo_sim")
    add_options(parser)
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
    ask_for_realtime(PROCESS_PRIORITY)  # like the executor's: beside busy processes it would play its points late
    return run_service("leeloo_sim", parser, start)


if __name__ == "__main__":
    sys.exit(main())
