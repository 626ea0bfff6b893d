"""What a robot with mass makes of plans: `python tests/benchmarks/physics.py [--plans 30] [--seed 0]`.

The M1013, its mass that of its geometry, among nine posts, is sent from one random configuration to the next, by each strategy of the executor and each
preset of drives: planned, verified, driven by the real state machine, all on a simulated clock. From the true joints:

- `off path`: how far a joint is from the path, whenever that is, the worst of each motion, median and worst (mrad);
- `at the end`: how far from the goal the arm rests, the worst joint, median and worst (mrad);
- `overshoot`: how much further beyond the goal a joint has been than the path is (mrad, worst);
- `late`: how much longer the motion took than planned (s, median);
- `flange`: acceleration of the tip as felt over 20 ms, worst over planned (ratio, median);
- `tip off`: how far the tip is from the nearest place on its path, the worst of all motions without contact (mm);
- `contacts`: motions in which anything touched, though the plan keeps 5 mm; `failed`: goals that did not succeed.

Where there are contacts, the motions are planned again with the margin that was measured, `tip off`, between goals that keep it.
"""

from __future__ import annotations

import argparse
import logging
import sys
import tempfile
from collections import Counter
from pathlib import Path

from zarm_trajectory.arrays import Array

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from rich.console import Console
from rich.table import Table

from support.arrivals import arrival
from support.executor.driver_bench import EVERY, JOINTS, Case, DriverBench, distance_from
from support.trajectories import HOME, ROBOT
from zarm_contract.errors import ZarmError
from zarm_contract.messages import AddObjects, CheckRequest, Cuboid, JointGoal, PlanRequest, SceneEdit
from zarm_executor.goal import Goal
from zarm_executor.monitor import Monitor
from zarm_geometry.robot_model import RobotModel
from zarm_physics_sim.arm import PhysicalArm
from zarm_physics_sim.drives import PRESETS
from zarm_physics_sim.simulation import Simulation
from zarm_physics_sim.world import World
from zarm_planner.handlers import Handlers
from zarm_planner.scene.store import SceneStore
from zarm_simulated_driver.player import STEP
from zarm_trajectory.trajectory import TimedTrajectory

MODEL = RobotModel.of(ROBOT)
POSTS = tuple(
    Cuboid(kind="cuboid", name=f"post_{k}", position=(0.7 * np.cos(a), 0.7 * np.sin(a), 0.4), size=(0.06, 0.06, 0.8))
    for k, a in enumerate(np.linspace(0.3, 2 * np.pi, 9, endpoint=False))
)
LONGEST = 60.0
STRATEGIES = ("joint_speed", "joint_pose", "joint_trajectory")


class Arm(PhysicalArm):
    """An arm of the bench, which looks at the points that are played."""

    touched = False

    @property
    def fraction(self) -> float:
        """The played share of the last command."""
        return self.played / self.total if self.total else 1.0

    @property
    def feed(self) -> Array:
        """The present commanded velocity (J,)."""
        return self._player.feed


def arm() -> tuple[Simulation, list[bool]]:
    """The robot among the posts, and whether anything has touched."""
    return Simulation(ROBOT, World({post.name: post for post in POSTS}), HOME), []


def measured(
    strategy: str, preset: str, plans: int, seed: int, margin: float | None = None
) -> tuple[list[str], int, float]:
    """A row of the table, the number of motions with a contact, and how far the tip was from its path in those without (m)."""
    rng, settings = np.random.default_rng(seed), PRESETS[preset]
    off, end, over, late, felt, deviation = [], [], [], [], [], [0.0]
    counts: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        handlers = Handlers(MODEL, "physics", SceneStore(folder), lambda: HOME)
        handlers.warm_up(lambda _: None)
        handlers.edit(SceneEdit(edit=AddObjects(op="add", objects=POSTS)))
        bench = DriverBench(Case(strategy, settings.plays, EVERY), folder)
        simulation, touches = arm()
        physical = Arm(
            simulation, settings, range(6), seed, lambda now: touches.append(any(True for _ in now.contacts()))
        )
        bench.arm = physical  # type: ignore[assignment]
        bench.run(0.5)
        while counts["plans"] < plans:
            goal = rng.uniform([-2.5, -0.8, 0.6, -1.5, -0.5, -1.5], [2.5, 0.8, 2.0, 1.5, 1.8, 1.5])
            if margin is not None and _clearance(handlers, goal) < margin:
                continue  # a goal that is nearer is allowed
            start = tuple(bench.positions[-1].tolist())
            try:
                plan = handlers.plan(
                    PlanRequest(
                        goal=JointGoal(kind="joints", position=tuple(goal.tolist())), start=start, margin=margin
                    )
                )
            except ZarmError:
                counts["refused"] += 1
                if counts["refused"] > 10 * plans:
                    break
                continue
            counts["plans"] += 1
            path = TimedTrajectory.of(plan.trajectory, JOINTS)
            touches.clear()
            tips: list[Array] = []
            true: list[Array] = []
            bench.machine.start(Goal(f"goal-{counts['plans']}", None, path, Monitor(path, ROBOT.descriptor)), arrival())
            began = bench.now
            while bench.machine.state().mode != "idle" and bench.now < began + LONGEST:
                bench.tick()
                true.append(simulation.position)
                tips.append(MODEL.fk_tip(true[-1])[:3, 3])
                if bench.machine.state().mode == "fault":
                    break
            if bench.last().status != "succeeded":
                counts["failed"] += 1
                bench.machine.reset(arrival()) if bench.machine.state().mode == "fault" else None
            took = bench.now - began
            bench.run(0.5)
            off.append(max(distance_from(path, q) for q in true[::5]))
            rest, way = simulation.position, np.sign(path.position[-1] - path.position[0])
            planned = path.positions(np.linspace(0.0, path.duration, 500))
            end.append(float(np.abs(rest - path.position[-1]).max()))
            beyond, meant = ((way * (each - path.position[-1])).max(axis=0) for each in (np.array(true), planned))
            over.append(float((beyond - meant).max()))
            late.append(took - path.duration)
            felt.append(_acceleration(np.array(tips), bench.period) / _planned(path))
            counts["contacts"] += any(touches)
            if not any(touches):
                deviation.append(_tip_deviation(path, np.array(tips)))
    worst = [f"{1e3 * np.median(each):.1f} / {1e3 * max(each):.1f}" for each in (off, end)]
    kept = "" if margin is None else f", margin {1e3 * margin:.0f} mm"
    row = [
        strategy, preset + kept, *worst, f"{1e3 * max(over):.1f}", f"{np.median(late):.2f}", f"{np.median(felt):.2f}",
        f"{1e3 * max(deviation):.1f}", f"{counts['contacts']} / {plans}", str(counts["failed"]),
    ]  # fmt: skip
    return row, counts["contacts"], max(deviation)


def _clearance(handlers: Handlers, q: Array) -> float:
    """The least distance (m) of the posts from the robot's spheres."""
    return min(handlers.check(CheckRequest(joints=(tuple(q.tolist()),), spheres=True)).results[0].spheres or (0.0,))


def _tip_deviation(path: TimedTrajectory, tips: Array) -> float:
    """How far (m) the tips (N, 3) are from the path of the tip."""
    places = np.array([MODEL.fk_tip(q)[:3, 3] for q in path.positions(np.linspace(0.0, path.duration, 1000))])
    steps = np.diff(places, axis=0)
    squares = np.maximum(np.square(steps).sum(axis=1), 1e-18)
    worst = 0.0
    for tip in tips[::5]:
        away = tip - places[:-1]
        share = np.clip((away * steps).sum(axis=1) / squares, 0.0, 1.0)
        worst = max(worst, float(np.linalg.norm(away - share[:, None] * steps, axis=1).min()))
    return worst


def _acceleration(tips: Array, period: float) -> float:
    """The largest acceleration (m/s²) of a point that passes `tips` (N, 3) in time, over two periods."""
    velocity = (tips[2:] - tips[:-2]) / (2 * period)
    return float(np.linalg.norm((velocity[2:] - velocity[:-2]) / (2 * period), axis=1).max())


def _planned(path: TimedTrajectory) -> float:
    times = np.arange(0.0, path.duration, STEP)
    return _acceleration(np.array([MODEL.fk_tip(q)[:3, 3] for q in path.sample(times)[0]]), STEP)


def main() -> None:
    """Print the table."""
    logging.disable()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plans", type=int, default=30, help="motions per row")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    columns = (
        "strategy",
        "drives",
        "off path mrad",
        "at the end mrad",
        "overshoot mrad",
        "late s",
        "flange",
        "tip off mm",
        "contacts",
        "failed",
    )
    table = Table(*columns)
    for preset, settings in PRESETS.items():
        for strategy in STRATEGIES:
            if strategy == "joint_pose" and settings.plays == "velocity":
                continue
            row, contacts, deviation = measured(strategy, preset, arguments.plans, arguments.seed)
            rows = [row]
            if contacts:
                rows.append(measured(strategy, preset, arguments.plans, arguments.seed, margin=deviation)[0])
            for row in rows:
                Console(stderr=True).print(*row)
                table.add_row(*row)
    Console(width=160).print(table)


if __name__ == "__main__":
    main()
