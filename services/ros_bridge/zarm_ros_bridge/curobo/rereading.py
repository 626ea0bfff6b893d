"""Makes every service of the robot load a changed descriptor."""

from __future__ import annotations

import time

from zarm_contract.errors import Unavailable
from zarm_contract.messages import Nothing
from zarm_contract.robot import load_robot
from zarm_ros_bridge.engine import Engine

RESTART_SECONDS = 60.0
"""Longest wait (s) for a restarting service; a planner takes some seconds, and half a minute if it has to compile."""

_SERVICES = ("executor", "planner")  # the executor first: only it may refuse, and then nothing has changed
_WHERE_THERE = ("servo",)
_FIXED = ("name", "base_link", "tip_link", "joints", "tools", "strategy_params")


def reread_robot(engine: Engine) -> str:
    """Have the robot's file read again, and wait until the restarted services are ready; returns what was done, empty
    if nothing has changed.

    The active strategy is restored. Raises InvalidRequest for a faulty file, Busy while the robot moves, and
    Unavailable if a service does not return in time, or if what the bridge depends on has changed in the file.
    """
    robot = load_robot(str(engine.robot.path))
    changed = [name for name in _FIXED if getattr(robot.descriptor, name) != getattr(engine.robot.descriptor, name)]
    if changed or robot.urdf != engine.robot.urdf:
        raise Unavailable(
            f"{changed[0] if changed else 'urdf'} has changed in {robot.path}, and the ROS interface depends on it; restart "
            "zarm to apply it"
        )
    strategy = engine.client.strategy().active
    renewed = []
    there = [service for service in _WHERE_THERE if engine.bus.alive(engine.keys.alive(service, "*"))]
    for service in (*_SERVICES, *there):
        if engine.client.connection.ask(engine.keys.reread(service), Nothing()).robot_hash != robot.hash:
            renewed.append(service)
            _wait_for(engine, service, robot.hash)
    if engine.client.strategy().active != strategy:
        engine.client.strategy(strategy)
    engine.robot = robot
    return f"{' and '.join(renewed)} have restarted with it" if renewed else ""


def _wait_for(engine: Engine, service: str, robot_hash: str) -> None:
    deadline = time.monotonic() + RESTART_SECONDS
    while time.monotonic() < deadline:
        try:
            health = engine.client.health(service, timeout=1.0)
        except Unavailable:
            health = None
        if health is not None and health.ready and health.robot_hash == robot_hash:
            return
        time.sleep(0.05)
    raise Unavailable(
        f"the {service} has not come back with the changed robot within {RESTART_SECONDS:g} s; its log says why"
    )
