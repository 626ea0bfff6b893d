"""Serves the tools of one robot until the client leaves."""

from __future__ import annotations

from contextlib import ExitStack, suppress
from pathlib import Path

from zarm.connection import connected
from zarm_contract.errors import InvalidRequest, ZarmError
from zarm_contract.messages import Nothing
from zarm_contract.robot import load_robot
from zarm_geometry.robot_model import RobotModel
from zarm_mcp.agent import Agent
from zarm_mcp.policy import Policy, read_policy
from zarm_mcp.server import make_server
from zarm_mcp.twin import Twin
from zarm_runtime.version import version


def serve(
    robot: str, policy: Path | None, http: str | None, endpoint: str, name: str | None, twin: str | None = None
) -> None:
    """Serve over stdin and stdout, or HTTP at `http`, `host:port`; a twin of the robot is on the bus at `twin`. Raises Unavailable without a robot, and
    InvalidRequest.
    """
    allowed = Policy() if policy is None else read_policy(policy)
    description = load_robot(robot)
    model = RobotModel.of(description)
    if twin == endpoint:
        raise InvalidRequest("the twin is on a bus of its own; start it with another --listen", field="--twin")
    with ExitStack() as stack:
        connection = stack.enter_context(connected(endpoint, name, role="agent"))
        known = connection.bus.call(connection.keys.health("planner"), Nothing(), timeout=5.0)
        if known.robot_hash != description.hash:
            raise InvalidRequest(f"the planner has another robot than {robot}; name the same descriptor", field="robot")
        rehearsing = (
            None if twin is None else Twin(stack.enter_context(connected(twin, name)), {*description.urdf.links})
        )
        agent = Agent(connection, model, allowed, rehearsing)
        agent.open()
        try:
            server = make_server(agent, allowed, connection, version())
            if http is None:
                server.run("stdio")
            else:
                host, port = _place(http)
                server.run("streamable-http", host=host, port=port)
        finally:
            with suppress(ZarmError):
                agent.close()


def _place(http: str) -> tuple[str, int]:
    host, _, port = http.rpartition(":")
    if not host or not port.isdecimal():
        raise InvalidRequest(f"{http} is no host:port, as 127.0.0.1:8765", field="--http")
    return host, int(port)
