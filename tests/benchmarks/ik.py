"""Kinematics: single solutions, all branches, and batches on kernels and on torch: `python tests/benchmarks/ik.py [--poses 10000]`.

CPU time of one thread, from Python, after warm-up: on an idle machine the time it takes; batches by the clock, since a GPU
works beside it. Poses are those of random joints. The robots of MotionBenchMaker take part where ../shared/mbm is, and
EAIK's closed form as a second opinion on branches where it is installed (`pip install --no-deps eaik==1.2.2`). Plots into
docs/images/ik.png.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import matplotlib as mpl
import numpy as np
from rich.console import Console
from rich.table import Table

from zarm_trajectory.arrays import Array

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.planner import motion_bench
from zarm_contract.messages import Device
from zarm_contract.robot import load_robot
from zarm_geometry.robot_model import RobotModel
from zarm_planner.deadline import Deadline
from zarm_planner.kinematics.batches import batch_fk, batch_ik
from zarm_planner.kinematics.ik import solve_ik
from zarm_planner.warm_up import warm_up

mpl.use("Agg")
from matplotlib import pyplot as plt

EAIK = importlib.util.find_spec("eaik") is not None


ROBOTS = ("doosan_m1013", "ur5e", "ur10e", "panda")
NEAR = 0.1
"""Standard deviation (rad) of each joint of a near start from those that made the pose."""
MANY = 500
"""Poses of which all branches are asked for."""
SIZES = (1, 10, 100, 1000)
PLOT = Path(__file__).parents[2] / "docs" / "images" / "ik.png"


def main() -> None:
    """Print the tables and draw the plot."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--poses", type=int, default=10_000, help="poses of each robot")
    options = parser.parse_args()
    console = Console(width=140)
    models = {name: RobotModel.of(load_robot(name)) for name in ROBOTS}
    if motion_bench.AVAILABLE:
        with tempfile.TemporaryDirectory() as folder:
            models |= {
                f"MBM {name}": RobotModel.of(motion_bench.robot(name, Path(folder))) for name in motion_bench.ROBOTS
            }
    warm_up(models["panda"], lambda _: None)
    table, singles = singles_table(models, options.poses)
    console.print(table)
    console.print(branches_table(models))
    if not EAIK:
        console.print("EAIK is not installed; pip install --no-deps eaik==1.2.2 puts its closed form beside")
    table, batches = batches_table(models["ur5e"])
    console.print(table)
    draw(singles, batches)
    console.print(f"plotted into {PLOT}")


def singles_table(models: dict[str, RobotModel], poses: int) -> tuple[Table, dict[str, Array]]:
    """One solution of each pose from a random start and from a near one; also the seconds from the random start."""
    columns = ("far: misses", "median us", "p95 us", "near: misses", "median us", "p95 us")
    table = Table("robot", *columns, title=f"one solution of each of {poses} poses")
    times: dict[str, Array] = {}
    for name, model in models.items():
        rng = np.random.default_rng(1)
        joints, starts = rng.uniform(model.lower, model.upper, (2, poses, model.dof))
        near = np.clip(joints + rng.normal(scale=NEAR, size=joints.shape), model.lower, model.upper)
        targets, cells = model.fk_tip(joints), []
        for start in (starts, near):
            seconds, found = timed(model, targets, start, 1)
            cells += [str(np.sum(found == 0)), *median_p95(seconds)]
            times.setdefault(name, seconds)
        table.add_row(name, *cells)
    return table, times


def branches_table(models: dict[str, RobotModel]) -> Table:
    """Up to 16 solutions of each pose; and how many of EAIK's branches, turned into the limits, are among all solutions."""
    columns = ("solutions", "median us", "p95 us", "of EAIK's branches", "median us", "EAIK us")
    table = Table("robot", *columns, title=f"16 solutions, and all, of each of {MANY} poses")
    for name, model in models.items():
        rng = np.random.default_rng(2)
        joints, starts = rng.uniform(model.lower, model.upper, (2, MANY, model.dof))
        targets = model.fk_tip(joints)
        seconds, found = timed(model, targets, starts, 16)
        closed = closed_form_cells(model, targets) if EAIK else ["", "", ""]
        table.add_row(name, f"{found.mean():.1f}", *median_p95(seconds), *closed)
    return table


def timed(model: RobotModel, targets: Array, starts: Array, most: int) -> tuple[Array, Array]:
    """Seconds and number of solutions of each pose."""
    seconds, found = np.empty(len(targets)), np.empty(len(targets), int)
    for i, (target, start) in enumerate(zip(targets, starts, strict=True)):
        stop, began = Deadline(60.0), time.thread_time()
        result = solve_ik(model, target, start, world=None, max_solutions=most, seed=i, deadline=stop)
        seconds[i], found[i] = time.thread_time() - began, len(result.solutions)
    return seconds, found


def closed_form_cells(model: RobotModel, targets: Array) -> list[str]:
    """Branches found of those that EAIK knows, and the time of both for all; dashes where it has no closed form for the arm."""
    from eaik.IK_Homogeneous import HomogeneousRobot

    if model.dof > 6:
        return ["-", "-", "-"]
    frames = [np.eye(4)]
    for origin in model.origin:
        frames.append(frames[-1] @ np.vstack((origin, (0.0, 0.0, 0.0, 1.0))))
    arm = HomogeneousRobot(np.array([*frames[1:], model.fk_tip(np.zeros(model.dof))]))
    if not arm.hasKnownDecomposition():
        return ["-", "-", "-"]
    known = hit = 0
    ours, theirs = [], []
    for i, target in enumerate(targets):
        began = time.thread_time()
        answer = arm.IK(target)
        theirs.append(time.thread_time() - began)
        stop, began = Deadline(60.0), time.thread_time()
        rows = solve_ik(
            model, target, np.zeros(model.dof), world=None, max_solutions=1000, seed=i, deadline=stop
        ).solutions
        ours.append(time.thread_time() - began)
        branches = np.array(answer.Q)[~np.array(answer.is_LS)]
        branches -= 2.0 * np.pi * np.ceil((branches - model.upper) / (2.0 * np.pi))  # the highest turn in the limits
        for q in branches[np.all(branches >= model.lower, axis=1)]:
            known += 1
            hit += bool(np.any(np.abs((rows - q + np.pi) % (2.0 * np.pi) - np.pi).max(axis=1) < 0.1))
    return [f"{hit} / {known}", *(f"{1e6 * np.median(seconds):.0f}" for seconds in (ours, theirs))]


def batches_table(model: RobotModel) -> tuple[Table, dict[str, list[float]]]:
    """Milliseconds of batches of the UR5e by the clock, the best of three; a GPU takes part where there is one."""
    from torch import cuda

    devices: list[Device] = ["kernels", "cpu", *(["cuda"] if cuda.is_available() else [])]
    table = Table("device", *(f"{what} {n}" for what in ("FK", "IK") for n in SIZES), title="batches of a UR5e, ms")
    rng, lines = np.random.default_rng(3), {}
    joints = rng.uniform(model.lower, model.upper, (max(SIZES), model.dof))
    poses, near = model.fk_tip(joints), np.zeros(model.dof)
    for device in devices:
        fk, ik = [], []
        for n in SIZES:
            fk.append(min(clocked(lambda: batch_fk(model, joints[:n], device)) for _ in range(3)))  # noqa: B023
            ik.append(
                min(
                    clocked(
                        lambda: batch_ik(
                            model,
                            poses[:n],  # noqa: B023
                            near,
                            world=None,
                            max_solutions=1,
                            seed=0,
                            device=device,  # noqa: B023
                            deadline=Deadline(600.0),
                        )
                    )
                    for _ in range(3 if n < 1000 else 1)
                )
            )
        lines |= {f"FK, {device}": fk, f"IK, {device}": ik}
        table.add_row(device, *(f"{1e3 * value:.2f}" for value in (*fk, *ik)))
    return table, lines


def clocked(call: Callable[[], object]) -> float:
    """Seconds by the clock."""
    began = time.perf_counter()
    call()
    return time.perf_counter() - began


def median_p95(seconds: Array) -> tuple[str, str]:
    """Both in us."""
    return f"{1e6 * np.median(seconds):.1f}", f"{1e6 * np.percentile(seconds, 95):.1f}"


def draw(singles: dict[str, Array], batches: dict[str, list[float]]) -> None:
    """The part of the poses that is solved after so much time, and the time of batches over their size."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.2))
    for name, seconds in singles.items():
        left.step(
            1e6 * np.sort(seconds), 100.0 * np.arange(1, len(seconds) + 1) / len(seconds), where="post", label=name
        )
    left.set(xscale="log", xlabel="CPU time (us)", ylabel="solved (%)", title="one solution from a random start")
    for name, values in batches.items():
        right.plot(SIZES, 1e3 * np.array(values), "o-" if name.startswith("IK") else "o:", label=name)
    right.set(xscale="log", yscale="log", xlabel="poses or configurations", ylabel="time (ms)", title="batches, UR5e")
    for axes in (left, right):
        axes.grid(alpha=0.3)
        axes.legend(fontsize="small")
    PLOT.parent.mkdir(exist_ok=True)
    figure.savefig(PLOT, dpi=120, bbox_inches="tight")


if __name__ == "__main__":
    main()
