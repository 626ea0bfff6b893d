"""Three servos on the same robot, scenes and targets: `python tests/benchmarks/servo_against_field.py [--plot]`.

*zarm*: the controller of the servo, with the planner's global plans where it is stuck; both run here in one process, and a plan is there
in the cycle after it was asked for. *MoveIt Servo, as documented*: a damped-least-squares inverse of the Jacobian at 100 Hz, slowed near
singularities; collision checks at 10 Hz, each of which scales the speed by `exp(k (distance - threshold))`, with k such that 0.001 is left
in contact; limits of speed kept by scaling all joints alike, the output smoothed by the low-pass filter that is its default. *pink*: differential IK as
a quadratic program at 250 Hz with limits of position and speed; it is told of no obstacles. It takes part where `pip install pin-pink daqp` was run.

Both peers follow poses with a proportional gain of 4/s and limit no acceleration, so that a far target makes them jump to full speed. The robot is where it is commanded to be. Closest distances, to objects and of the robot to
itself, are those of the exact shapes, 20 ms apart; a contact is a distance of 0 or less. The jerk is the difference of the commanded
accelerations over 20 ms, as a multiple of the robot's limit.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from zarm_trajectory.arrays import Array

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import matplotlib
import numpy as np
from rich.console import Console
from rich.table import Table

from support.servo.tracking import Tracker, planner_in
from zarm_contract.messages import Cuboid, SceneObject, Sphere
from zarm_contract.robot import load_robot
from zarm_geometry.exact import ExactScene
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.handlers import Handlers
from zarm_servo.kernels.step import PERIOD
from zarm_servo.tracking.targets import PoseTarget, rotation_vector
from zarm_trajectory.limits import Limits

matplotlib.use("Agg")
from matplotlib import pyplot

Servo = Callable[[Array], Array]
"""Given the pose (4, 4) that is to be reached, the joints (J,) one PERIOD later."""

PLOT = Path(__file__).parents[2] / "docs" / "images" / "servo.png"
MARGIN, SECONDS, GAIN = 0.01, 8.0, 4.0
REACHED = 0.001, 0.01
MODEL = RobotModel.of(load_robot("doosan_m1013"))
LIMITS = Limits.of(MODEL.robot)
START = np.array(MODEL.robot.descriptor.home)
TIP = MODEL.fk_tip(START)


@dataclass(frozen=True)
class Case:
    """A pose to be reached from home, in a scene."""

    name: str
    objects: tuple[SceneObject, ...]
    goal: Array


@dataclass(frozen=True)
class Outcome:
    """What one servo did: seconds to 1 mm and 0.01 rad at rest (infinite: never), jerk, distances (N,) and errors (N,) in m."""

    seconds: float
    jerk: float
    distances: Array
    errors: Array


def moved(x: float, y: float, z: float) -> Array:
    """The pose of the tip at home, moved (m)."""
    pose = TIP.copy()
    pose[:3, 3] += x, y, z
    return pose


def box(name: str, place: tuple[float, float, float], size: tuple[float, float, float]) -> Cuboid:
    """A box, from the tip at home."""
    x, y, z = (TIP[:3, 3] + place).tolist()
    return Cuboid(kind="cuboid", name=name, position=(x, y, z), size=size)


def ball(name: str, place: tuple[float, float, float], radius: float) -> Sphere:
    """A ball, from the tip at home."""
    x, y, z = (TIP[:3, 3] + place).tolist()
    return Sphere(kind="sphere", name=name, position=(x, y, z), radius=radius)


CASES = (
    Case("free space, 0.3 m away", (), moved(0.05, 0.3, -0.05)),
    Case("free space, 0.8 m away", (), moved(-0.1, 0.8, 0.0)),
    Case("past a ball", (ball("ball", (0.0, 0.3, 0.03), 0.06),), moved(0.0, 0.55, 0.0)),
    Case("behind a panel", (box("panel", (0.1, 0.3, 0.0), (0.4, 0.04, 0.4)),), moved(0.0, 0.6, 0.0)),
    Case(
        "down to a table, 20 mm above it", (box("table", (0.0, 0.0, -0.367), (0.8, 0.8, 0.1)),), moved(0.0, 0.1, -0.28)
    ),
    Case("inside a wall", (box("wall", (0.3, 0.0, 0.0), (0.1, 3.0, 2.0)),), moved(0.3, 0.1, 0.0)),
    Case("out of reach", (), moved(1.5, 0.0, 0.5)),
)


class Zarm:
    """The controller of the servo and its local goal."""

    def __init__(self, case: Case, planner: Handlers) -> None:
        self._tracker = Tracker(MODEL, case.objects, planner, START, MARGIN)

    def __call__(self, goal: Array) -> Array:
        return np.asarray(self._tracker.step(PoseTarget(goal)).state[0])


class MoveItServo:
    """What the documentation of MoveIt Servo says, with its default thresholds."""

    PUBLISHED, CHECKED = 0.01, 0.1
    PROXIMITY, SELF_PROXIMITY = 0.02, 0.01
    SINGULAR, STOP = 17.0, 30.0
    """Condition numbers between which it slows down."""
    FILTER = 1.5
    """Coefficient of its low-pass filter."""

    def __init__(self, world: World) -> None:
        self._scene, self._alone = ExactScene(MODEL, world), ExactScene(MODEL, World((), 0.0))
        self._filtered, self._raw = START.copy(), START.copy()
        self._scale, self._cycle = 1.0, 0

    def __call__(self, goal: Array) -> Array:
        if self._cycle % round(self.CHECKED / PERIOD) == 0:
            from_scene = self._scene.nearest(self._filtered, itself=False).distance
            from_itself = self._alone.nearest(self._filtered).distance
            self._scale = min(scale(from_scene, self.PROXIMITY), scale(from_itself, self.SELF_PROXIMITY))
        before = int((self._cycle - 1) * PERIOD / self.PUBLISHED)
        if self._cycle == 0 or int(self._cycle * PERIOD / self.PUBLISHED) != before:
            self._publish(goal)
        self._cycle += 1
        return self._filtered.copy()

    def _publish(self, goal: Array) -> None:
        jacobian = MODEL.tip_jacobian(self._filtered)
        u, values, v = np.linalg.svd(jacobian)
        condition = float(values[0] / max(values[-1], 1e-9))
        slowed = float(np.clip((self.STOP - condition) / (self.STOP - self.SINGULAR), 0.0, 1.0))
        inverse = (v.T[:, : len(values)] * (values / (values**2 + 0.01**2))) @ u.T
        speed = inverse @ (GAIN * error(self._filtered, goal)) * self._scale * max(slowed, 0.01)
        speed /= max(1.0, float((np.abs(speed) / LIMITS.velocity).max()))
        raw = self._filtered + self.PUBLISHED * speed
        # Butterworth, first order: y = (x + x' + (c - 1) y') / (c + 1)
        self._filtered = (raw + self._raw + (self.FILTER - 1) * self._filtered) / (self.FILTER + 1)
        self._raw = raw


def scale(distance: float, threshold: float) -> float:
    """The share of the speed that MoveIt Servo leaves at a distance (m) below a threshold (m)."""
    rate = -np.log(0.001) / threshold
    return 0.0 if distance <= 0.0 else min(1.0, float(np.exp(rate * (distance - threshold))))


def pink_servo(_: World) -> Servo:
    """pink's differential IK. Raises ImportError where it is not installed."""
    import pinocchio
    from pink import Configuration, solve_ik
    from pink.tasks import FrameTask

    robot = pinocchio.buildModelFromUrdf(str(MODEL.robot.urdf_path))
    configuration = Configuration(robot, robot.createData(), START.copy())
    task = FrameTask(MODEL.robot.descriptor.tip_link, position_cost=1.0, orientation_cost=0.3, gain=GAIN * PERIOD)

    def step(goal: Array) -> Array:
        task.set_target(pinocchio.SE3(goal[:3, :3], goal[:3, 3]))
        velocity = solve_ik(configuration, [task], PERIOD, solver="daqp")
        configuration.integrate_inplace(velocity, PERIOD)
        return np.asarray(configuration.q).copy()

    return step


def error(position: Array, goal: Array) -> Array:
    """What is missing (6,) to a pose: m and rad, in the base frame."""
    tip = MODEL.fk_tip(position)
    return np.concatenate((goal[:3, 3] - tip[:3, 3], rotation_vector(goal[:3, :3] @ tip[:3, :3].T)))


def run(servo: Servo, case: Case, world: World) -> Outcome:
    """Have a servo follow the goal of a case."""
    positions = np.array([START, *(servo(case.goal) for _ in range(round(SECONDS / PERIOD)))])
    missing = np.array([error(position, case.goal) for position in positions])
    errors, turns = np.linalg.norm(missing[:, :3], axis=1), np.linalg.norm(missing[:, 3:], axis=1)
    resting = np.abs(np.diff(positions, axis=0, append=positions[-1:])).max(axis=1) < 1e-3 * PERIOD * 5
    away = np.flatnonzero(~((errors < REACHED[0]) & (turns < REACHED[1]) & resting))
    last = 0 if len(away) == 0 else int(away[-1]) + 1
    coarse = positions[::5]
    jerk = np.diff(coarse, 3, axis=0) / (5 * PERIOD) ** 3
    scene = ExactScene(MODEL, world)
    distances = np.array([scene.nearest(position).distance for position in positions[::5]])
    return Outcome(
        last * PERIOD if last < len(positions) - 1 else np.inf,
        float((np.abs(jerk) / LIMITS.jerk).max()),
        distances,
        errors,
    )


def main() -> None:
    """Print the table, and draw with `--plot`."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plot", action="store_true", help=f"draw {PLOT.name}")
    plots = parser.parse_args().plot
    table = Table("target", "servo", "s to 1 mm", "left, mm", "jerk / limit", "closest, mm", "contact")
    outcomes: dict[tuple[str, str], Outcome] = {}
    with tempfile.TemporaryDirectory() as folder:
        for case in CASES:
            planner = planner_in(MODEL, "arm", Path(folder) / case.name.replace(" ", "_"), case.objects)
            world = World(case.objects, 0.0)
            servos: dict[str, Callable[[], Servo]] = {
                "zarm": lambda case=case, planner=planner: Zarm(case, planner),  # type: ignore[misc]
                "MoveIt Servo, as documented": lambda world=world: MoveItServo(world),  # type: ignore[misc]
                "pink": lambda world=world: pink_servo(world),  # type: ignore[misc]
            }
            for name, make in servos.items():
                try:
                    outcome = run(make(), case, world)
                except ImportError as missing:
                    table.add_row(case.name, name, f"not installed: {missing.name}")
                    continue
                outcomes[case.name, name] = outcome
                closest = float(outcome.distances.min())
                table.add_row(
                    case.name,
                    name,
                    "never" if outcome.seconds == np.inf else f"{outcome.seconds:.2f}",
                    f"{1e3 * outcome.errors[-1]:.1f}",
                    f"{outcome.jerk:.2f}",
                    f"{1e3 * closest:.1f}",
                    "yes" if closest <= 0.0 else "",
                )
            planner.close()
    Console(width=140, file=sys.stdout).print(table)
    if plots:
        draw(outcomes)


def draw(outcomes: dict[tuple[str, str], Outcome]) -> None:
    """What is left to the target, and the distance that is kept, over time."""
    figure, axes = pyplot.subplots(
        2, len(CASES), figsize=(3.2 * len(CASES), 6), sharex=True, sharey="row", squeeze=False
    )
    for column, case in enumerate(CASES):
        for (of, name), outcome in outcomes.items():
            if of == case.name:
                axes[0][column].semilogy(PERIOD * np.arange(len(outcome.errors)), 1e3 * outcome.errors, label=name)
                axes[1][column].plot(
                    5 * PERIOD * np.arange(len(outcome.distances)), 1e3 * outcome.distances, label=name
                )
        axes[0][column].set_title(case.name, fontsize=9)
        axes[1][column].axhline(0.0, color="black", linewidth=0.5)
        axes[1][column].set_xlabel("s")
    axes[0][0].set_ylabel("left to the target, mm")
    axes[1][0].set_ylabel("distance to the nearest, mm")
    axes[0][0].legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(PLOT, dpi=110)


if __name__ == "__main__":
    main()
