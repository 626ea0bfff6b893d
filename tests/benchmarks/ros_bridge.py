"""What the ROS bridge costs: on top of a plan, between a driver and a client, and while nothing is asked of it.

    python tests/benchmarks/ros_bridge.py [--plans 200] [--seconds 10]

The same plan over Zenoh and from rclpy in turn, pair by pair, and beside them what ROS itself takes to carry a trajectory
of as many points from a server of plain rclpy that has it ready; joint states from a driver on ROS to a client on Zenoh at 100
and 1000 Hz, with what was lost; the processor time and the memory of a bridge whose robot stands, and what bridge and
executor take while a driver on ROS tells at 100 Hz that it does.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import psutil
from rclpy.client import Client
from rich.console import Console
from rich.table import Table
from sensor_msgs.msg import JointState as RosJointState

from curobo_msgs.srv import SetPlanner, TrajectoryGeneration

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.harness import PATIENCE, eventually
from support.paths import PROGRAMS
from support.ros.client import RosClient
from support.ros.domain import isolate
from support.ros.node import answer
from support.ros.stack import KEYS, stack
from support.trajectories import HOME, ROBOT, moved
from zarm_contract import messages as m
from zarm_runtime.bus import Bus

GOALS = [moved(0.6, 0.2), moved(-0.5, 0.3, -0.2), moved(0.2, -0.3, 0.4, 0.5), moved(1.0)]


@contextmanager
def ready_made(bus: Bus) -> Iterator[str]:
    """The name of a service that answers at once, with as many points as a plan has."""
    goal = m.JointGoal(kind="joints", position=tuple(GOALS[0].tolist()))
    plan = bus.call(KEYS.plan, m.PlanRequest(goal=goal, start=tuple(HOME.tolist())), timeout=30)
    points = round(plan.trajectory.duration / ROBOT.descriptor.interpolation_dt) + 1
    program = [sys.executable, str(PROGRAMS / "ros_ready_made.py"), "/ready_made", str(points)]
    process = subprocess.Popen([*program, *ROBOT.descriptor.joints])
    try:
        yield "/ready_made"
    finally:
        process.kill()
        process.wait(PATIENCE)


def asked_of(ros: RosClient, service: str) -> Client:
    """A client of a trajectory's service that is there."""
    client = ros.node.create_client(TrajectoryGeneration, service)
    client.wait_for_service(PATIENCE)
    return client


def plans(bus: Bus, ros: RosClient, ready: Client, count: int) -> tuple[list[float], list[float], list[float]]:
    """Seconds of the same plans over Zenoh and over ROS, and of an answer that is ready made, in turn."""
    ros.call(SetPlanner, "set_planner", planner_type=SetPlanner.Request.JOINT_SPACE)
    client = asked_of(ros, "/unified_planner/generate_trajectory")
    start = RosJointState(name=list(ROBOT.descriptor.joints), position=HOME.tolist())
    over_zenoh, over_ros, by_ros = [], [], []
    for index in range(count):
        goal = GOALS[index % len(GOALS)].tolist()
        request = m.PlanRequest(
            goal=m.JointGoal(kind="joints", position=tuple(goal)),
            start=tuple(HOME.tolist()),
            max_attempts=1,
            timeout=5.0,
            margin=0.025,
        )
        asked = TrajectoryGeneration.Request(start_pose=start, target_joint_positions=goal)
        began = time.perf_counter()
        bus.call(KEYS.plan, request, timeout=30)
        between = time.perf_counter()
        answered = answer(client.call_async(asked), "the bridge plans")
        after = time.perf_counter()
        answer(ready.call_async(asked), "the trajectory that is ready comes")
        by_ros.append(time.perf_counter() - after)
        over_ros.append(after - between)
        over_zenoh.append(between - began)
        if not answered.success:
            raise SystemExit(answered.message)
    return over_zenoh, over_ros, by_ros


def joint_states(bus: Bus, ros: RosClient, rate: float, seconds: float) -> tuple[list[float], int]:
    """Latencies (s) of joint states from a driver on ROS to a client on Zenoh, and how many were sent."""
    arrived: list[float] = []
    bus.subscribe(KEYS.driver_joint_states, lambda _, state: arrived.append(time.time() - state.stamp))
    publisher = ros.node.create_publisher(RosJointState, "/dsr01/joint_states", 10)
    eventually(publisher.get_subscription_count, "the bridge listens")
    sent, deadline = int(rate * seconds), time.monotonic()
    for _ in range(sent):  # of a robot that moves: of one that stands, some go no further
        deadline += 1 / rate
        time.sleep(max(0.0, deadline - time.monotonic()))
        message = RosJointState(name=list(ROBOT.descriptor.joints), position=HOME.tolist(), velocity=[0.1] * 6)
        now = time.time_ns()
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(now, 10**9)
        publisher.publish(message)
    time.sleep(0.5)
    ros.node.destroy_publisher(publisher)
    return arrived, sent


def idle(process: psutil.Process, seconds: float) -> float:
    """The share of one core that a bridge takes while the robot stands and tells its joints."""
    before = process.cpu_times()
    time.sleep(seconds)
    after = process.cpu_times()
    return (after.user + after.system - before.user - before.system) / seconds


def idle_with_driver(seconds: float) -> dict[str, float]:
    """The shares of one core that each service takes while a driver on ROS tells joints at 100 Hz, and nothing moves."""
    services = {"executor": ("--strategy", "joint_speed"), "leeloo_sim": ("--ros",)}
    with tempfile.TemporaryDirectory() as folder, stack(Path(folder), **services) as running:
        found = {name: psutil.Process(running.processes[name].process.pid) for name in ("ros_bridge", "executor")}
        with ThreadPoolExecutor() as pool:
            shares = pool.map(lambda process: idle(process, seconds), found.values())
        return dict(zip(found, shares, strict=True))


def milliseconds(values: list[float] | np.ndarray) -> list[str]:
    """Median, p99 and greatest."""
    return [f"{1e3 * value:.2f}" for value in (*np.percentile(values, (50, 99)), np.max(values))]


def main() -> None:
    """Run all of it and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--plans", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=10.0)
    options = parser.parse_args()
    isolate()
    table = Table("what", "median ms", "p99 ms", "max ms", "", title="ROS bridge")
    with tempfile.TemporaryDirectory() as folder, stack(Path(folder)) as running:
        bus, ros = running.bus, running.ros
        bridge = psutil.Process(running.processes["ros_bridge"].process.pid)
        with ready_made(bus) as service:
            ready = asked_of(ros, service)
            plans(bus, ros, ready, 10)
            over_zenoh, over_ros, by_ros = plans(bus, ros, ready, options.plans)
        table.add_row("plan over Zenoh", *milliseconds(over_zenoh), "")
        table.add_row("plan over ROS", *milliseconds(over_ros), "")
        table.add_row("what the bridge adds", *milliseconds(np.subtract(over_ros, over_zenoh)), "pair by pair")
        table.add_row("ROS alone, ready made", *milliseconds(by_ros), "no planner, no bridge")
        over_plain = np.subtract(over_ros, over_zenoh) - by_ros
        table.add_row("the bridge over that", *milliseconds(over_plain), "pair by pair")
        for rate in (100.0, 1000.0):
            arrived, sent = joint_states(bus, ros, rate, options.seconds)
            lost = f"{sent - len(arrived)} of {sent} lost"
            table.add_row(f"joint states at {rate:g} Hz", *milliseconds(arrived), lost)
        share = idle(bridge, options.seconds)
        memory = bridge.memory_info().rss / 2**20
    Console().print(table)
    Console().print(
        f"idle: {share:.1%} of a core, with the joints of the emulated robot at their rate; {memory:.0f} MB"
    )
    shares = ", ".join(f"{name} {share:.1%}" for name, share in idle_with_driver(options.seconds).items())
    Console().print(f"idle, with a driver on ROS at 100 Hz: {shares} of a core")


if __name__ == "__main__":
    main()
