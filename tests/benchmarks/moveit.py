"""What MoveIt's interface costs: on top of a plan, and while nothing is asked of it.

    python tests/benchmarks/moveit.py [--plans 200] [--seconds 10]

The same plan over Zenoh and from rclpy in turn, pair by pair: by `plan_kinematic_path`, and by `move_action` with `plan_only`; beside them
what ROS itself takes, for an action of plain rclpy that has a trajectory of as many points ready. Then the
processor time and the memory of the bridge of a robot that stands, without and with --moveit, nobody listening and with a client of /tf.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import psutil
from moveit_msgs.action import MoveGroup
from moveit_msgs.msg import PlanningOptions
from moveit_msgs.srv import GetMotionPlan
from rclpy.action import ActionClient
from rclpy.node import Node
from rich.console import Console
from rich.table import Table
from tf2_msgs.msg import TFMessage

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.harness import PATIENCE
from support.paths import PROGRAMS
from support.ros.domain import isolate
from support.ros.moveit import SUCCESS, joints, request
from support.ros.node import answer, on_its_thread
from support.ros.stack import KEYS, Stack, stack
from support.trajectories import ROBOT, moved
from zarm_contract import messages as m
from zarm_runtime.bus import Bus

GOALS = [moved(0.6, 0.2), moved(-0.5, 0.3, -0.2), moved(0.2, -0.3, 0.4, 0.5), moved(1.0)]


@contextmanager
def ready_made(bus: Bus) -> Iterator[str]:
    """The name of an action that has a trajectory ready, of as many points as a plan has."""
    plan = bus.call(
        KEYS.plan, m.PlanRequest(goal=m.JointGoal(kind="joints", position=tuple(GOALS[0].tolist()))), timeout=30
    )
    program = [
        sys.executable,
        str(PROGRAMS / "ros_ready_made_action.py"),
        "/ready_made",
        str(len(plan.trajectory.time)),
    ]
    process = subprocess.Popen([*program, *ROBOT.descriptor.joints])
    try:
        yield "/ready_made"
    finally:
        process.kill()
        process.wait(PATIENCE)


def acted(node: Node, client: ActionClient, goal: object) -> object:
    """The result of a goal."""
    handle = on_its_thread(node, lambda: client.send_goal_async(goal))
    handle = answer(handle, "the goal is accepted") if hasattr(handle, "add_done_callback") else handle
    return answer(handle.get_result_async(), "the goal ends").result


def pairs(running: Stack, ready: str, count: int) -> dict[str, list[float]]:
    """Seconds of the same plans: over Zenoh, by the service and by the action, in turn, and of the action that is ready."""
    node = running.ros.node
    client, other = ActionClient(node, MoveGroup, "/move_action"), ActionClient(node, MoveGroup, ready)
    for one in (client, other):
        one.wait_for_server(PATIENCE)
    names = ("Zenoh", "plan_kinematic_path", "move_action", "an action of rclpy that plans nothing")
    found: dict[str, list[float]] = {name: [] for name in names}
    service = node.create_client(GetMotionPlan, "/plan_kinematic_path")
    service.wait_for_service(PATIENCE)
    for index in range(count):
        goal = GOALS[index % len(GOALS)].tolist()
        plain = m.PlanRequest(goal=m.JointGoal(kind="joints", position=tuple(goal)), timeout=5.0)
        asked = request(joints(ROBOT.descriptor.joints, goal))
        began = time.perf_counter()
        running.bus.call(KEYS.plan, plain, timeout=30)
        found["Zenoh"].append(time.perf_counter() - began)
        began = time.perf_counter()
        planned = answer(service.call_async(GetMotionPlan.Request(motion_plan_request=asked)), "it is planned")
        found["plan_kinematic_path"].append(time.perf_counter() - began)
        wanted = MoveGroup.Goal(request=asked, planning_options=PlanningOptions(plan_only=True))
        began = time.perf_counter()
        result = acted(node, client, wanted)
        found["move_action"].append(time.perf_counter() - began)
        began = time.perf_counter()
        acted(node, other, wanted)
        found[names[-1]].append(time.perf_counter() - began)
        for code in (planned.motion_plan_response.error_code, result.error_code):
            if code.val != SUCCESS:
                raise SystemExit(code)
    return found


def idle(process: psutil.Process, seconds: float) -> float:
    """The share of one core that a process takes."""
    before = process.cpu_times()
    time.sleep(seconds)
    after = process.cpu_times()
    return (after.user + after.system - before.user - before.system) / seconds


def main() -> None:
    """Run all of it and print two tables."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--plans", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=10.0)
    options = parser.parse_args()
    isolate()
    shares = Table("bridge", "CPU, % of a core", "MB", title="at rest")
    table = Table("", "median ms", "p99 ms", "added, median ms", title="one plan")
    for arguments in ((), ("--moveit",)):
        with tempfile.TemporaryDirectory() as folder, stack(Path(folder), ros_bridge=arguments) as running:
            bridge = psutil.Process(running.processes["ros_bridge"].process.pid)
            if arguments:
                with ready_made(running.bus) as ready:
                    found = pairs(running, ready, options.plans)
                for name, values in found.items():
                    p50, p99 = 1e3 * np.percentile(values, (50, 99))
                    added = 1e3 * np.median(np.subtract(values, found["Zenoh"]))
                    table.add_row(name, f"{p50:.2f}", f"{p99:.2f}", f"{added:.2f}")
            time.sleep(3)
            label = " ".join(("zarm-ros-bridge", *arguments))
            shares.add_row(label, f"{100 * idle(bridge, options.seconds):.1f}", f"{bridge.memory_info().rss / 1e6:.0f}")
            if arguments:
                running.ros.heard(TFMessage, "/tf")
                time.sleep(3)
                shares.add_row(f"{label}, /tf listened to", f"{100 * idle(bridge, options.seconds):.1f}", "")
    console = Console()
    console.print(table)
    console.print(shares)


if __name__ == "__main__":
    main()
