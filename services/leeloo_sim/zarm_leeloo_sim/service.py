"""The process of the simulated driver: wires the arm to the bus."""

from __future__ import annotations

import logging
import math
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np

from zarm_contract.bus import Bus
from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import DriverCommand, DriverFault, DriverProgress, JointState
from zarm_contract.service import Service, run_service, service_parser
from zarm_leeloo_sim.driver import Driver
from zarm_leeloo_sim.player import Player

log = logging.getLogger(__name__)

HUMBLE_ORDER = (0, 1, 3, 4, 2, 5)
"""The order in which the M1013's joints are told on ROS 2 Humble: 1, 2, 4, 5, 3, 6."""


@contextmanager
def start(service: Service) -> Iterator[None]:
    """The simulated arm, at `--at` or at the descriptor's `home`, from its first step to its last."""
    descriptor, keys, options = service.robot.descriptor, service.keys, service.options
    params = descriptor.strategy_params
    order = (None if params is None else params.joint_order) or descriptor.joints
    at = descriptor.home if options.at is None else tuple(options.at)
    if len(at) != len(descriptor.joints):
        raise InvalidRequest(
            f"{len(at)} positions for {len(descriptor.joints)} joints; give one for each", field="--at"
        )
    told = tuple(order[index] for index in HUMBLE_ORDER) if len(order) == len(HUMBLE_ORDER) else order
    position = np.array([at[descriptor.joints.index(name)] for name in order])
    with ExitStack() as stack:
        bus = stack.enter_context(Bus(options.connect))
        trace = None if options.trace is None else stack.enter_context(options.trace.open("a", buffering=1))
        progress = bus.publisher(keys.driver_progress, DriverProgress, realtime=True)
        driver = Driver(
            Player(position, plays=options.plays, ceiling=math.radians(options.ceiling)),
            order,
            told,
            bus.publisher(keys.driver_joint_states, JointState, realtime=True).put,
            (lambda _: None) if options.no_progress else progress.put,
            trace,
        )
        bus.subscribe(keys.driver_command, DriverCommand, driver.command)
        bus.serve(keys.simulated_fault, DriverFault, driver.suffer)
        ended = threading.Event()
        thread = threading.Thread(target=driver.run, args=(ended,), name="arm")
        thread.start()
        service.ready()
        try:
            yield
        finally:
            ended.set()
            thread.join()


def main() -> int:
    """Run the simulated driver of one robot until SIGTERM or SIGINT; the exit code."""
    parser = service_parser("leeloo_sim")
    parser.add_argument("--at", type=float, nargs="+", metavar="RAD", help="where the arm stands (default: home)")
    parser.add_argument(
        "--plays",
        choices=("velocity", "position"),
        default="velocity",
        help="what of a point it plays (default: velocity)",
    )
    parser.add_argument(
        "--ceiling", type=float, default=70.0, metavar="DEG", help="deg/s and deg/s^2 of every joint (default: 70)"
    )
    parser.add_argument("--no-progress", action="store_true", help="tell no progress, as some drivers do not")
    parser.add_argument("--trace", type=Path, metavar="FILE", help="append where the arm truly is, whatever it tells")
    return run_service("leeloo_sim", parser, start)


if __name__ == "__main__":
    sys.exit(main())
