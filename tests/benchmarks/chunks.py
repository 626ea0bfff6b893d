"""How well the servo follows chunks of a policy: `python tests/benchmarks/chunks.py [--seconds S] [--cells N]`.

The first table is of real processes (router, planner, executor with the emulator, servo) and a UR5e that swings by 0.4 rad at 0.4 Hz, asked 30 times a
second for 50 points each, and 30 or 100 times a second for one position: how far what is measured is behind what was asked for, how far off it is without
that lag and with it, the peak of the jerk of the measured joints against the limit, and how long the servo's cycles took.

The second is of the servo's controller alone, and of two that check nothing, in the same cells: a policy that sees no obstacle, whose chunks come late
and are lost, and have noise of 1 mrad, sweeps the arm past a post and a table. *Cubic spline* goes through the points of the newest chunk from the
position, velocity and acceleration of the one before, as ros2_controllers' trajectory controller replaces a trajectory; *linear steps* go straight from
point to point. Contacts are those of the exact shapes; the error is that to the policy's motion without noise, where the servo is not
in the way of an obstacle.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
import urllib.request
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import numpy as np
from prometheus_client.parser import text_string_to_metric_families
from rich.console import Console
from rich.table import Table
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from zarm_trajectory.arrays import Array

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import zarm
from support.harness import ServiceProcess, free_endpoint, router
from zarm_contract.errors import InvalidRequest
from zarm_contract.keys import Keys
from zarm_contract.messages import Cuboid, JointPoints, JointState, SceneObject, ServoChunk
from zarm_contract.robot import load_robot
from zarm_geometry.exact import ExactScene
from zarm_geometry.motion_check import MotionCheck
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_runtime.bus import Bus
from zarm_servo.kernels.step import PERIOD
from zarm_servo.tracking.chunk_tracking import ChunkTracking
from zarm_servo.tracking.controller import Controller, Limitation, Surroundings
from zarm_servo.tracking.grip_follower import GripFollower
from zarm_servo.tracking.session import soft
from zarm_trajectory.limits import Limits

Motion = Callable[[Array], Array]

MODEL = RobotModel.of(load_robot("ur5e"))
LIMITS = Limits.of(MODEL.robot)
HOME = np.array(MODEL.robot.descriptor.home)
DT, POINTS = 1 / 30, 50
NOISE, LATE, LOST = 0.001, 0.15, 0.1
"""Of the policy (rad); longest delay of a chunk (s); share of chunks that are lost."""


def swing(begun: float, frequency: float = 0.4, size: float = 0.4) -> Motion:
    """Two joints that swing about HOME, more and more over the first 2 s."""

    def motion(times: Array) -> Array:
        passed = np.atleast_1d(times) - begun
        u = np.clip(passed / 2.0, 0.0, 1.0)
        wave = size * u**3 * (10.0 - 15.0 * u + 6.0 * u**2) * np.sin(2 * np.pi * frequency * passed)
        return HOME + wave[:, None] * np.array([1.0, 0.0, 0.0, 0.5, 0.0, 0.0])

    return motion


# -- processes --


def of_processes(seconds: float) -> Table:
    """How a real servo follows."""
    table = Table(
        "UR5e, emulator, 0.4 rad at 0.4 Hz",
        "lag",
        "error without lag",
        "error",
        "jerk / limit",
        "cycle, p99.9",
    )
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        endpoint = stack.enter_context(router())
        bus = stack.enter_context(Bus(endpoint))
        keys = Keys("ur5e")
        exported = free_endpoint().removeprefix("tcp/")
        for name, arguments in (("planner", ()), ("executor", ()), ("servo", ("--metrics", exported))):
            service = ServiceProcess(name, endpoint, folder, robot="ur5e", arguments=arguments)
            stack.enter_context(service).wait_ready(bus, keys)
        robot = stack.enter_context(zarm.connect(endpoint, "ur5e"))
        for name, rate, chunks in (
            ("chunks of 50 points, 30/s", 30, True),
            ("positions, 30/s", 30, False),
            ("positions, 100/s", 100, False),
        ):
            table.add_row(name, *measured(robot, bus, keys, exported, rate, seconds, chunks=chunks))
    return table


def measured(
    robot: Any, bus: Bus, keys: Keys, exported: str, rate: int, seconds: float, *, chunks: bool
) -> tuple[str, ...]:
    """One row of the table."""
    states: list[JointState] = []
    begun = time.time() + 0.5
    motion = swing(begun)
    stop = bus.subscribe(keys.joint_states, lambda _, state: states.append(state))
    cycles = cycles_within(exported)
    with robot.track(chunks=True) if chunks else robot.track() as tracking:
        due, end = time.monotonic(), time.monotonic() + seconds
        while time.monotonic() < end:
            now = time.time()
            if chunks:
                tracking.follow(motion(now + DT * np.arange(POINTS)), dt=DT, start=now)
            else:
                tracking.to(motion(np.array([now]))[0])
            due += 1 / rate
            time.sleep(max(0.0, due - time.monotonic()))
        ended = time.time()
    stop()
    robot.execute(robot.plan(HOME))
    stamps = np.array([state.stamp for state in states])
    joints = np.array([state.position for state in states])
    counted = (stamps > begun + 2.5) & (stamps < ended - 0.2)
    stamps, joints = stamps[counted], joints[counted]
    shifts = np.arange(-0.05, 0.4, 0.001)
    errors = [rms(joints - motion(stamps - shift)) for shift in shifts]
    best = int(np.argmin(errors))
    smooth = CubicSpline(stamps, joints)(np.arange(stamps[0], stamps[-1], 0.02))
    jerk = np.abs(np.diff(smooth, 3, axis=0)).max(axis=0) / 0.02**3
    return (
        f"{1e3 * shifts[best]:.0f} ms",
        f"{1e3 * errors[best]:.2f} mrad",
        f"{1e3 * rms(joints - motion(stamps)):.2f} mrad",
        f"{np.max(jerk / LIMITS.jerk):.2f}",
        f"{1e3 * quantile(0.999, cycles, cycles_within(exported)):.1f} ms",
    )


def cycles_within(exported: str) -> dict[float, float]:
    """How many cycles of the servo took at most so long (s), by its metrics."""
    with urllib.request.urlopen(f"http://{exported}/metrics") as answer:
        families = text_string_to_metric_families(answer.read().decode())
    samples = [sample for family in families for sample in family.samples]
    return {float(one.labels["le"]): one.value for one in samples if one.name == "zarm_servo_cycle_seconds_bucket"}


def quantile(share: float, before: dict[float, float], after: dict[float, float]) -> float:
    """How long (s) this share of the cycles between two readings took at most: linear within a bucket, as Prometheus has it."""
    counts = {bound: count - before.get(bound, 0.0) for bound, count in after.items()}
    return float(np.interp(share * max(counts.values()), [0.0, *counts.values()], [0.0, *counts]))


def rms(errors: Array) -> float:
    """The root mean square of the joint that is furthest off."""
    return float(np.sqrt((errors**2).mean(axis=0)).max())


# -- the controller, and others --


class Servo:
    """The servo's controller in a cell."""

    def __init__(self, objects: tuple[SceneObject, ...]) -> None:
        check = MotionCheck(MODEL)
        check.set_world(World(objects, 0.0))
        limits = soft(LIMITS)
        self._controller = Controller(MODEL, check, limits, HOME, margin=0.01)
        nothing: Any = None
        self._chunks = ChunkTracking(
            MODEL, limits, self._controller, GripFollower(nothing, nothing, nothing), lambda: None
        )
        self._limitation, self._sequence = Limitation("target_stale"), 0

    def take(self, rows: Array, made: float, now: float) -> None:
        self._sequence += 1
        points = JointPoints(kind="joints", position=tuple(map(tuple, rows.tolist())))
        chunk = ServoChunk(goal_id="a", sequence=self._sequence, stamp=made, dt=DT, points=points)
        with suppress(InvalidRequest):  # it jumps: the robot follows the one before to its end
            self._chunks._inbox.receive(chunk, now, now, now, self._controller.state[0])

    def step(self, now: float) -> Array:
        step = self._chunks.step(now, 1.0, Surroundings(), self._limitation)
        if step is None:
            step = self._controller.step(None, 0.0)
        self._limitation = step.limitation
        return np.asarray(step.state[0])


class Spline:
    """What a controller does that plays the newest chunk."""

    def __init__(self, *, cubic: bool) -> None:
        self._cubic, self._at, self._ends = cubic, HOME, 0.0
        self._play: Callable[[float], Array] = lambda _: HOME
        self._now, self._before = 0.0, HOME

    def take(self, rows: Array, made: float, now: float) -> None:
        times = made + DT * np.arange(len(rows))
        left = times > now + 1e-6
        if not left.any():
            return
        times, rows = np.append(now, times[left]), np.vstack((self._at, rows[left]))
        if self._cubic:
            speeds = np.gradient(rows, times, axis=0)
            speeds[0] = (self._at - self._before) / PERIOD
            self._play = CubicHermiteSpline(times, rows, speeds)
        else:
            self._play = lambda now: np.array([np.interp(now, times, column) for column in rows.T])
        self._ends = float(times[-1])

    def step(self, now: float) -> Array:
        self._before = self._at
        self._at = np.asarray(self._play(min(now, self._ends)))
        return self._at


def of_controllers(cells: int) -> Table:
    """The servo's controller beside others."""
    rows: dict[str, list[tuple[float, float, bool]]] = {"servo": [], "cubic spline": [], "linear steps": []}
    for seed in range(cells):
        rng = np.random.default_rng(seed)
        objects = cell(rng)
        scene = ExactScene(MODEL, World(objects, 0.0))
        motion = swing(0.0, float(rng.uniform(0.2, 0.4)), 0.9)
        followers = {"servo": Servo(objects), "cubic spline": Spline(cubic=True), "linear steps": Spline(cubic=False)}
        mail = [
            (
                made + rng.uniform(0.0, LATE),
                made,
                motion(made + DT * np.arange(POINTS)) + NOISE * rng.normal(size=(POINTS, 6)),
            )
            for made in np.arange(0.0, 8.0, DT)
            if rng.random() > LOST
        ]
        mail.sort(key=lambda letter: letter[0])
        paths: dict[str, list[Array]] = {name: [] for name in followers}
        for now in np.arange(PERIOD, 8.0, PERIOD):
            while mail and mail[0][0] <= now:
                _, made, points = mail.pop(0)
                for follower in followers.values():
                    follower.take(points, made, now)
            for name, follower in followers.items():
                paths[name].append(follower.step(now))
        wanted = motion(np.arange(PERIOD, 8.0, PERIOD))
        apart = scene.nearest(wanted[::5]).distance > 0.05
        for name, path in paths.items():
            joints = np.array(path)
            error = rms((joints - wanted)[len(joints) // 3 :]) if apart else float("nan")
            jerk = float((np.abs(np.diff(joints[50:], 3, axis=0)).max(axis=0) / PERIOD**3 / LIMITS.jerk).max())
            rows[name].append((error, jerk, bool(scene.nearest(joints[::2]).distance <= 0.0)))
    table = Table(f"{cells} cells, chunks late, lost and noisy", "error", "peak jerk / limit", "runs with contact")
    for name, found in rows.items():
        error, jerk, contact = np.array(found).T
        table.add_row(name, f"{1e3 * np.nanmedian(error):.2f} mrad", f"{np.median(jerk):.1f}", f"{int(contact.sum())}")
    return table


def cell(rng: np.random.Generator) -> tuple[SceneObject, ...]:
    """A table, and in half of the cells a post in the way of the tip."""
    table = Cuboid(kind="cuboid", name="table", position=(0.0, 0.0, -0.06), size=(2.0, 2.0, 0.1))
    if rng.random() < 0.5:
        return (table,)
    turned = HOME + rng.choice((-1.0, 1.0)) * rng.uniform(0.4, 0.8) * np.array([1.0, 0, 0, 0, 0, 0])
    x, y, _ = MODEL.fk_tip(turned)[:3, 3].tolist()
    return table, Cuboid(kind="cuboid", name="post", position=(x, y, 0.4), size=(0.05, 0.05, 0.8))


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10.0, help="of each measurement with processes")
    parser.add_argument("--cells", type=int, default=40, help="in which the controllers are compared")
    options = parser.parse_args()
    console = Console(width=140)
    console.print(of_controllers(options.cells))
    console.print(of_processes(options.seconds))


if __name__ == "__main__":
    main()
