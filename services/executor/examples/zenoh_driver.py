"""A driver that connects a robot to zarm over Zenoh, without ROS; here with an ideal arm instead of hardware.

    python zenoh_driver.py --joints joint_1 joint_2 joint_3 joint_4 joint_5 joint_6 --at 0 0 1.570796 0 1.570796 0

It needs only `eclipse-zenoh`, so any language with Zenoh will do. Call your controller in `Arm`. zarm expects:
- it publishes its joints on `zarm/<robot>/driver/joint_states`, rather at 100 Hz than at 20, moving or not, each time
  with a new `stamp`: a message with an old one counts as silence;
- it plays the newest `driver/command` from its arrival on, one point at each `time`, dropping the rest of the last;
- it drops a command that arrives more than `expires_after` s after it published the joints with the stamp `based_on`;
- a command without points, or the end of the points, brings the robot to rest: the watchdog for a dead executor;
- it publishes on `driver/progress` how much of the command is played, or the descriptor has no `state_topic`;
- it refuses what its robot cannot do: its limits of velocity and acceleration are the last line of defence.
"""

from __future__ import annotations

import argparse
import json
import threading
import time
from collections import deque
from typing import Any

import zenoh

PERIOD = 0.01


class Arm:
    """An arm that moves at the commanded velocity at once. Yours talks to a controller instead."""

    def __init__(self, position: list[float]) -> None:
        self.position, self.velocity = position, [0.0] * len(position)

    def move(self, velocity: list[float], dt: float) -> None:
        """Move at these velocities (rad/s) for `dt` s."""
        self.velocity = velocity
        self.position = [q + v * dt for q, v in zip(self.position, velocity, strict=True)]


class Driver:
    """Plays commands on an arm whose joints have these names, in this order."""

    def __init__(self, session: zenoh.Session, robot: str, joints: list[str], arm: Arm) -> None:
        self._joints, self._arm, self._stepped = joints, arm, time.monotonic()
        self._newest: tuple[float, dict[str, Any]] = (0.0, {})
        self._reports: deque[tuple[float, float]] = deque(maxlen=1000)
        prefix = f"zarm/{robot}/driver"
        self._states = session.declare_publisher(f"{prefix}/joint_states", express=True)
        self._progress = session.declare_publisher(f"{prefix}/progress", express=True)
        self._commands = session.declare_subscriber(f"{prefix}/command", self._receive)

    def _receive(self, sample: zenoh.Sample) -> None:
        now, command = time.monotonic(), json.loads(sample.payload.to_bytes())
        based_on, expires_after = command.get("based_on", -1.0), command.get("expires_after", 0.0)
        reported = next((moment for stamp, moment in reversed([*self._reports]) if stamp <= based_on), -1e9)
        in_time = not command.get("time") or now - reported <= expires_after
        if in_time and sorted(command["joint_names"]) == sorted(self._joints):
            self._newest = now, command

    def step(self) -> None:
        """One period: play what is due, and publish the joints."""
        now, stamp, (began, command) = time.monotonic(), time.time(), self._newest
        times, rows, played = command.get("time", []), command.get("velocity", []), 0
        while self._stepped < now:  # a late machine skips no point
            dt, self._stepped = min(now - self._stepped, PERIOD), min(now, self._stepped + PERIOD)
            at = self._stepped - began
            played = max(1, sum(moment <= at for moment in times))
            velocity = self._arm.velocity if at < 0.0 else [0.0] * len(self._joints)
            if rows and 0.0 <= at < times[-1] + PERIOD:
                velocity = [rows[played - 1][command["joint_names"].index(joint)] for joint in self._joints]
            self._arm.move(velocity, dt)
        if times:
            self._progress.put(json.dumps({"sequence": command["sequence"], "fraction": played / len(times)}))
        joints = {"joint_names": self._joints, "position": self._arm.position, "velocity": self._arm.velocity}
        self._reports.append((stamp, now))
        self._states.put(json.dumps({"stamp": stamp, **joints}))


def main() -> None:
    """Run until interrupted."""
    parser = argparse.ArgumentParser(description="An example of a driver for zarm.")
    parser.add_argument("--connect", default="tcp/127.0.0.1:7447", help="the router's endpoint")
    parser.add_argument("--robot", default="doosan_m1013", help="the robot's name on the bus")
    parser.add_argument("--joints", nargs="+", required=True, help="names of the joints, in the driver's order")
    parser.add_argument("--at", nargs="+", type=float, required=True, help="where the arm stands, rad")
    parser.add_argument("--config", help="Zenoh's configuration of a client, where certificates are asked for")
    options = parser.parse_args()
    config = zenoh.Config.from_file(options.config) if options.config else zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([options.connect]))
    with zenoh.open(config) as session:
        driver = Driver(session, options.robot, options.joints, Arm(options.at))
        while not threading.Event().wait(PERIOD):
            driver.step()


if __name__ == "__main__":
    main()
