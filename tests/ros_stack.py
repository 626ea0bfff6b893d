"""The whole of zarm behind a bridge, and a client on ROS that knows nothing of it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from harness import PATIENCE, ServiceProcess, router
from rclpy.client import Client
from rclpy.node import Node
from ros_node import answer, running_node

from zarm_contract.bus import Bus
from zarm_contract.keys import Keys

KEYS = Keys("arm")


@dataclass
class RosClient:
    """A client of the services of /unified_planner; `call` waits for the answer."""

    node: Node
    _clients: dict[str, Client] = field(default_factory=dict)

    def call(self, kind: Any, name: str, /, **request: Any) -> Any:
        """The response of a service of the node."""
        client = self._clients.get(name)
        if client is None:
            client = self._clients[name] = self.node.create_client(kind, f"/unified_planner/{name}")
        assert client.wait_for_service(PATIENCE), f"there is no service {name}"
        return answer(client.call_async(kind.Request(**request)), f"{name} answers")


@dataclass
class Stack:
    """A client on ROS and one on the bus, and the processes behind them."""

    ros: RosClient
    bus: Bus
    processes: dict[str, ServiceProcess]


@contextmanager
def stack(folder: Path, *, robot: str = "doosan_m1013", planner: tuple[str, ...] = ()) -> Iterator[Stack]:
    """Router, planner, executor and bridge of a robot named `arm`, all ready; they must outlive what is done with them."""
    with router() as endpoint, Bus(endpoint) as bus:
        processes = {
            name: ServiceProcess(name, endpoint, folder, robot=robot, name=KEYS.robot, arguments=arguments)
            for name, arguments in (("planner", planner), ("executor", ()), ("ros_bridge", ()))
        }
        with processes["planner"], processes["executor"], processes["ros_bridge"], running_node("client") as node:
            for process in processes.values():
                process.wait_ready(bus, KEYS)
            yield Stack(RosClient(node), bus, processes)
            for process in processes.values():
                assert process.process.poll() is None, process.output()
