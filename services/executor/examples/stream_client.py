"""A closed-loop planner that drives zarm: here the first joint follows a swinging target, at 20 chunks a second.

    python stream_client.py --joints joint_1 joint_2 joint_3 joint_4 joint_5 joint_6 --seconds 10

It needs only `eclipse-zenoh`, nothing of zarm. What zarm expects of such a client:

- chunk 1 starts at 0 s of the stream, where the robot rests; each later one replaces the rest of those before;
- each chunk ends at rest, so that the robot can stop along it if this program dies;
- the next one arrives within `deadline` s of this one, or the robot brakes and the goal ends `aborted` (`timeout`);
- the state of the stream's goal, on `executor/goal/<goal_id>`, reports its progress and end; chunks are not answered.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import threading
import time

import zenoh

EVERY, HORIZON, BRAKING, STEP = 0.05, 0.3, 0.8, 0.02
"""Chunk interval, time following the target, time braking to rest, and sample interval of a chunk (s)."""


def target(t: float, amplitude: float, period: float) -> tuple[float, float, float]:
    """Position (rad), velocity and acceleration of the target at `t` s; yours comes from a sensor."""
    w, half = 2 * math.pi / period, amplitude / 2
    return half * (1 - math.cos(w * t)), half * w * math.sin(w * t), half * w * w * math.cos(w * t)


def braking(q: float, v: float, a: float, s: float) -> tuple[float, float, float]:
    """The state at the share `s` of braking from (q, v, a): velocity (v + b s)(1 - s)^2, its integral and derivative."""
    b = a * BRAKING + 2 * v
    return (
        q + BRAKING * (v * (1 - (1 - s) ** 3) / 3 + b * (s**2 / 2 - 2 * s**3 / 3 + s**4 / 4)),
        (v + b * s) * (1 - s) ** 2,
        (b * (1 - s) ** 2 - 2 * (v + b * s) * (1 - s)) / BRAKING,
    )


def main() -> None:
    """Follow the target for a while; exits with the error, if any."""
    parser = argparse.ArgumentParser(description="An example of a client that streams to zarm.")
    parser.add_argument("--connect", default="tcp/127.0.0.1:7447", help="the router's endpoint")
    parser.add_argument("--config", help="Zenoh's configuration of a client, where certificates are asked for")
    parser.add_argument("--robot", default="doosan_m1013", help="the robot's name on the bus")
    parser.add_argument("--joints", nargs="+", required=True, help="names of the joints; the first one moves")
    parser.add_argument("--seconds", type=float, default=10.0, help="how long to follow")
    parser.add_argument("--amplitude", type=float, default=0.3, help="how far the target swings, rad")
    parser.add_argument("--deadline", type=float, default=0.2, help="how long without a chunk until it brakes, s")
    parser.add_argument("--period", type=float, default=4.0, help="how long it takes to and fro, s")
    options = parser.parse_args()
    config = zenoh.Config.from_file(options.config) if options.config else zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([options.connect]))
    prefix, goal_id = f"zarm/{options.robot}", f"stream-{time.time_ns()}"
    measured, ended, problem, home = threading.Event(), threading.Event(), "", [0.0]

    def see_joints(sample: zenoh.Sample) -> None:
        state = json.loads(sample.payload.to_bytes())
        home[:] = [state["position"][state["joint_names"].index(joint)] for joint in options.joints]
        measured.set()

    def see_goal(sample: zenoh.Sample) -> None:
        nonlocal problem
        state = json.loads(sample.payload.to_bytes())
        problem = state.get("problem", {}).get("message", "")
        if state["status"] in ("succeeded", "cancelled", "aborted"):
            ended.set()

    with zenoh.open(config) as session:
        joints = session.declare_subscriber(f"{prefix}/joint_states", see_joints)
        session.declare_subscriber(f"{prefix}/executor/goal/{goal_id}", see_goal)
        stream = session.declare_publisher(f"{prefix}/executor/stream", express=True)
        measured.wait(10.0)
        joints.undeclare()
        began, sequence, t = time.monotonic(), 0, 0.0
        while t < options.seconds and not ended.is_set():
            t, sequence = (time.monotonic() - began) if sequence else 0.0, sequence + 1
            rows = [target(t + i * STEP, options.amplitude, options.period) for i in range(round(HORIZON / STEP) + 1)]
            rows += [braking(*rows[-1], s * STEP / BRAKING) for s in range(1, round(BRAKING / STEP) + 1)]
            trajectory = {"joint_names": options.joints, "time": [i * STEP for i in range(len(rows))]}
            for column, name in enumerate(("position", "velocity", "acceleration")):
                rest = home if name == "position" else [0.0] * len(home)
                trajectory[name] = [[rest[0] + row[column], *rest[1:]] for row in rows]
            chunk = {"goal_id": goal_id, "sequence": sequence, "start": t, "trajectory": trajectory}
            stream.put(json.dumps(chunk | {"deadline": options.deadline, "last": t >= options.seconds}))
            ended.wait(EVERY)
        ended.wait(10.0)
    if problem or not ended.is_set():
        sys.exit(problem or "the robot's executor does not answer")


if __name__ == "__main__":
    main()
