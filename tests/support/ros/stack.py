"""All of zarm behind a bridge, with a client on ROS and one on the bus."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from support.harness import PATIENCE, ServiceProcess, router
from support.paths import PROGRAMS
from support.ros.client import RosClient
from support.ros.node import running_node
from zarm_contract.keys import Keys
from zarm_contract.robot import RobotDescription
from zarm_runtime.bus import Bus

KEYS = Keys("arm")


@dataclass
class Stack:
    """The router's endpoint, a client on ROS and one on the bus, and the processes behind them."""

    endpoint: str
    ros: RosClient
    bus: Bus
    processes: dict[str, ServiceProcess]


@contextmanager
def stack(
    folder: Path, *, robot: str = "doosan_m1013", bridge: Path | None = None, **services: tuple[str, ...]
) -> Iterator[Stack]:
    """Router, planner, executor and bridge of a robot named `arm`, all ready; they must survive what is done with them.

    `services` gives the arguments of a service, and adds one that is not among these three; `bridge` is a script run
    instead of the bridge.
    """
    arguments: dict[str, tuple[str, ...]] = {"planner": (), "executor": (), "ros_bridge": (), **services}
    with ExitStack() as started:
        endpoint = started.enter_context(router())
        bus = started.enter_context(Bus(endpoint))
        processes = {
            name: started.enter_context(
                ServiceProcess(
                    name,
                    endpoint,
                    folder,
                    robot=robot,
                    name=KEYS.robot,
                    arguments=arguments[name],
                    script=str(bridge) if bridge is not None and name == "ros_bridge" else None,
                )
            )
            for name in arguments
        }
        node = started.enter_context(running_node("client"))
        for process in processes.values():
            process.wait_ready(bus, KEYS)
        yield Stack(endpoint, RosClient(node), bus, processes)
        for process in processes.values():
            assert process.process.poll() is None, process.output()


@contextmanager
def controller(robot: RobotDescription, *options: str) -> Iterator[subprocess.Popen[str]]:
    """The stand-in for a robot under ros2_control, at home; `--topic-alone` leaves its action out."""
    descriptor, params = robot.descriptor, robot.descriptor.strategy_params
    joints = [f"{name}={at}" for name, at in zip(descriptor.joints, descriptor.home, strict=True)]
    command = [sys.executable, str(PROGRAMS / "ros_controller.py"), params.command_topic]
    process = subprocess.Popen(
        [*command, params.joint_states_topic, *joints, *options], stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout.readline() == "ready\n"
        yield process
    finally:
        process.terminate()
        process.wait(PATIENCE)
        process.stdout.close()
