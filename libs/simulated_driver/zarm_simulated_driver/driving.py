"""What every simulated driver does in its process: its options, and the arm on the bus or on ROS."""

from __future__ import annotations

import argparse
import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from zarm_contract.errors import InvalidRequest, Unavailable
from zarm_contract.messages import DriverOutputCommand
from zarm_runtime.bus import Bus
from zarm_runtime.service import Service
from zarm_simulated_driver.axes import Axes
from zarm_simulated_driver.bus_side import BusSide
from zarm_simulated_driver.driver import Arm, Hands, SimulatedDriver
from zarm_trajectory.arrays import Array

if TYPE_CHECKING:
    from zarm_simulated_driver.ros_side import RosSide


def add_options(parser: argparse.ArgumentParser) -> None:
    """The options that `driving` and `start_position` read."""
    parser.add_argument(
        "--at", type=float, nargs="+", metavar="RAD", help="joint positions at the start (default: home)"
    )
    parser.add_argument("--no-progress", action="store_true", help="report no progress, like some drivers")
    parser.add_argument("--ros", action="store_true", help="use the ROS topics of the descriptor instead of the bus")
    parser.add_argument(
        "--trace", type=Path, metavar="FILE", help="append the true motion of the arm to this file, whatever it reports"
    )


def start_position(service: Service, axes: Axes) -> Array:
    """Where the arm is at first (J,), rad, in the driver's order: at `--at` or at home. Raises InvalidRequest."""
    descriptor, options = service.robot.descriptor, service.options
    at = descriptor.home if options.at is None else tuple(options.at)
    if len(at) != len(descriptor.joints):
        raise InvalidRequest(
            f"{len(at)} positions for {len(descriptor.joints)} joints; give one for each", field="--at"
        )
    return np.array([at[descriptor.joints.index(name)] for name in axes.names])


@contextmanager
def driving(service: Service, bus: Bus, axes: Axes, arm: Arm, hands: Hands) -> Iterator[None]:
    """Let `arm` and `hands` play what arrives, from their first step to their last. Raises InvalidRequest and
    Unavailable.
    """
    keys, options = service.keys, service.options
    with ExitStack() as stack:
        trace = None if options.trace is None else stack.enter_context(options.trace.open("a", buffering=1))
        side = stack.enter_context(_on_ros(service, axes)) if options.ros else BusSide(bus, keys, axes)
        driver = SimulatedDriver(
            arm,
            side.publish_joints,
            (lambda _: None) if options.no_progress else side.publish_progress,
            hands,
            bus.publisher(keys.driver_gripper_state).put,
            trace,
        )
        side.listen(driver.play)
        bus.subscribe(keys.driver_gripper_command, lambda _, command: driver.grip(command))
        outputs = bus.publisher(keys.driver_output_state)

        def switch(_: str, command: DriverOutputCommand) -> None:
            output = service.robot.descriptor.outputs.get(command.output)
            if output is None or (options.ros and output.service is not None):
                return  # that is not this driver's
            if (state := driver.switch(command)) is not None:
                outputs.put(state)

        bus.subscribe(keys.driver_output_command, switch)
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
    descriptor = service.robot.descriptor
    if descriptor.strategy_params is None:
        raise InvalidRequest(
            f"{descriptor.name} names no topics; write strategy_params into its descriptor", field="--ros"
        )
    try:
        from zarm_simulated_driver.ros_side import ros_side
    except ImportError as error:
        raise Unavailable(
            f"ROS 2 cannot be loaded ({error}); `make ros` installs it, or source an installation of ROS 2 Jazzy"
        ) from error
    return ros_side(f"{service.keys.robot}_driver", descriptor.strategy_params, axes)
