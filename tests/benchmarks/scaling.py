"""How planning scales: `python tests/benchmarks/scaling.py [--plans 40] [--most 10000] [--every 4]`.

With threads: plans per second of a planner in this process and of a planner process behind a router, asked by so many
clients at once, each a process. On two cores clients and planner compete there.
With objects: times of one thread against the number of objects, in clutter out of the arm's reach and around the arm; what
stands in the way of a plan in the empty scene is left out, so that there is always a way.

Prints tables and draws them into docs/images/scaling.png. Needs the problems in ../shared/mbm.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path

import matplotlib as mpl
import numpy as np
from rich.console import Console
from rich.table import Table

from zarm_trajectory.arrays import Array

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.harness import PATIENCE, ServiceProcess, router
from support.planner import motion_bench
from zarm_contract.errors import ZarmError
from zarm_contract.keys import Keys
from zarm_contract.messages import (
    Cuboid,
    JointGoal,
    LoadScene,
    Plan,
    PlanRequest,
    PlanTimings,
    SceneEdit,
    SceneObject,
)
from zarm_geometry.exact import ExactScene
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.context import PlanningContext
from zarm_planner.deadline import Deadline
from zarm_planner.handlers import Handlers
from zarm_planner.pipeline import plan
from zarm_planner.planners.free import FreePlanner
from zarm_planner.scene.planning_scene import PlanningScene
from zarm_planner.scene.store import SceneStore
from zarm_runtime.bus import Bus
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

mpl.use("Agg")
from matplotlib import pyplot as plt

PLOT = Path(__file__).parents[2] / "docs" / "images" / "scaling.png"
COUNTS = (10, 100, 1000, 10_000)
CLEAR = 0.03
"""Metres that clutter around the arm keeps away from the motion through the empty scene."""
ROBOT = "panda"


def main() -> None:
    """Print the tables and draw them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plans", type=int, default=40, help="plans per problem and number of threads")
    parser.add_argument("--most", type=int, default=COUNTS[-1], help="objects at most")
    parser.add_argument("--every", type=int, default=4, help="take every so-many-th problem")
    options = parser.parse_args()
    if not motion_bench.AVAILABLE:
        sys.exit(f"there is nothing to measure: MotionBenchMaker's problems are not in {motion_bench.PROBLEMS}")
    problems = [
        problem for scene in motion_bench.SCENES for problem in motion_bench.problems(ROBOT, scene)[:: options.every]
    ]
    console = Console(width=140)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        model = RobotModel.of(motion_bench.robot(ROBOT, folder))
        threads = in_process(model, folder / "state", problems[::4], options.plans)
        console.print(rates_table("threads of one process", threads))
        clients = over_router(folder, problems[::4], options.plans)
        console.print(rates_table("clients over the router", clients))
        counts = [count for count in COUNTS if count <= options.most]
        curves = {
            "out of reach": by_objects(model, problems, counts, around=False),
            "around the arm": by_objects(model, problems, counts, around=True),
        }
    for where, rows in curves.items():
        console.print(objects_table(where, counts, rows))
    draw({"threads of one process": threads, "clients over the router": clients}, counts, curves)
    console.print(f"drawn into {PLOT}")


# -- threads --


def requests(problem: motion_bench.Problem, count: int) -> list[PlanRequest]:
    """The same problem again and again, with other seeds."""
    goal = JointGoal(kind="joints", position=problem.goals[0])
    return [PlanRequest(goal=goal, start=problem.start, optimize_s=0.0, seed=seed) for seed in range(count)]


def in_process(model: RobotModel, folder: Path, problems: list[motion_bench.Problem], plans: int) -> dict[int, float]:
    """Plans per second by number of threads."""
    store = SceneStore(folder)
    planner = Handlers(model, ROBOT, store, lambda: np.zeros(model.dof))
    planner.warm_up(lambda _: None)
    spent = dict.fromkeys((1, 2), 0.0)
    for problem in problems:
        store.edit(SceneEdit(edit=LoadScene(op="load", objects=problem.objects)))
        asked = requests(problem, plans)
        answers(planner.plan, asked[:1])
        for count in spent:  # in turn, so that what else the machine does hits all alike
            with ThreadPoolExecutor(count) as pool:
                began = time.perf_counter()
                list(pool.map(lambda request: answers(planner.plan, [request]), asked))
                spent[count] += time.perf_counter() - began
    planner.close()
    return {count: plans * len(problems) / seconds for count, seconds in spent.items()}


def answers(ask: Callable[[PlanRequest], Plan], asked: list[PlanRequest]) -> int:
    """Ask one after the other; how many plans there were."""
    count = 0
    for request in asked:
        try:
            ask(request)
            count += 1
        except ZarmError:
            pass  # as much work as a plan, and the same however many threads there are
    return count


def over_router(folder: Path, problems: list[motion_bench.Problem], plans: int) -> dict[int, float]:
    """Plans per second by number of client processes."""
    spent = dict.fromkeys((1, 2, 4), 0.0)
    keys = Keys(ROBOT)
    with (
        router() as endpoint,
        ServiceProcess("planner", endpoint, folder, robot=str(folder / f"{ROBOT}.yaml")) as process,
        Bus(endpoint) as bus,
    ):
        process.wait_ready(bus, keys)
        # Each client is a pool of one, spawned: no process may be forked with a session open.
        spawn = multiprocessing.get_context("spawn")
        clients = [ProcessPoolExecutor(1, spawn, _connect, (endpoint,)) for _ in range(max(spent))]
        for problem in problems:
            edit = SceneEdit(edit=LoadScene(op="load", objects=problem.objects))
            bus.call(keys.scene_edit, edit, timeout=PATIENCE)
            asked = requests(problem, plans)
            for client in clients:
                client.submit(_ask, asked[:1]).result()
            for count in spent:
                began = time.perf_counter()
                parts = [clients[i].submit(_ask, asked[i::count]) for i in range(count)]
                for part in parts:
                    part.result()
                spent[count] += time.perf_counter() - began
        for client in clients:
            client.submit(_disconnect).result()
            client.shutdown()
    return {count: plans * len(problems) / seconds for count, seconds in spent.items()}


_bus: Bus | None = None


def _connect(endpoint: str) -> None:
    global _bus
    _bus = Bus(endpoint)


def _disconnect() -> None:
    if _bus:
        _bus.close()


def _ask(asked: list[PlanRequest]) -> int:
    def call(request: PlanRequest) -> Plan:
        if _bus is None:
            raise RuntimeError("this client has no session")
        return _bus.call(Keys(ROBOT).plan, request, timeout=PATIENCE)

    return answers(call, asked)


def rates_table(what: str, rates: dict[int, float]) -> Table:
    table = Table(what, "plans per second", "to one")
    for count, rate in rates.items():
        table.add_row(str(count), f"{rate:.1f}", f"{rate / rates[1]:.2f}")
    return table


# -- objects --


def by_objects(model: RobotModel, problems: list[motion_bench.Problem], counts: list[int], *, around: bool) -> Array:
    """Medians (counts, 4) in s: making a scene ready, search and shortcut, verify, the whole plan."""
    rng = np.random.default_rng(0)
    rows: list[list[tuple[float, ...]]] = [[] for _ in counts]
    for problem in problems:
        alone, _, _ = timed_plan(model, problem, [])
        objects = clutter(model, alone.position, counts[-1], rng, around=around)
        for count, row in zip(counts, rows, strict=True):
            _, timings, ready = timed_plan(model, problem, objects[:count])
            row.append((ready, timings.search + timings.shortcut, timings.verify, timings.total))
    return np.median(rows, axis=1)


def timed_plan(
    model: RobotModel, problem: motion_bench.Problem, objects: list[SceneObject]
) -> tuple[TimedTrajectory, PlanTimings, float]:
    """A motion among other objects than the problem's, where its time went, and the seconds that it took to make the scene ready."""
    began = time.perf_counter()
    world = World(objects, 0.005)
    snapshot = PlanningScene("1-000000000000", model, world, ExactScene(model, world))
    ready = time.perf_counter() - began
    goal = JointGoal(kind="joints", position=problem.goals[0])
    context = PlanningContext(snapshot, Limits.of(model.robot), Deadline(60.0))
    found = plan(FreePlanner(), context, np.array(problem.start), goal)
    return found.trajectory, context.timer.timings(), ready


def clutter(
    model: RobotModel, motion: Array, count: int, rng: np.random.Generator, *, around: bool
) -> list[SceneObject]:
    """Cubes of 1 to 3 cm in random order: within the arm's reach and off its motion, or in the 2 m beyond its reach."""
    reach = float(ExactScene(model, World([], 0.0)).reach[0])
    frames = model.link_transforms(motion[::4])
    arm = np.concatenate([(frames[:, link] @ shape.pose)[:, :3, 3] for link, shape in model.parts])
    off = max(shape.radius for _, shape in model.parts) + 0.03 * np.sqrt(3) / 2 + CLEAR
    centers = np.empty((0, 3))
    while len(centers) < count:
        more = rng.uniform(-1, 1, (4096, 3)) * (reach if around else reach + 2.0)
        away = np.linalg.norm(more, axis=1)
        if around:
            nearest = np.min([np.linalg.norm(more - part, axis=1) for part in arm], axis=0)
            more = more[(away < reach) & (nearest > off)]
        else:
            more = more[away > reach + off]
        centers = np.vstack((centers, more))
    sizes, turns = rng.uniform(0.01, 0.03, count), rng.normal(size=(count, 4))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    return [
        Cuboid(kind="cuboid", name=f"cube{i}", position=tuple(center), orientation=tuple(turn), size=(size, size, size))
        for i, (center, turn, size) in enumerate(zip(centers.tolist(), turns.tolist(), sizes.tolist(), strict=False))
    ]


STAGES = ("scene ready", "search + shortcut", "verify", "plan")


def objects_table(where: str, counts: list[int], rows: Array) -> Table:
    table = Table(f"objects {where}", *(f"{stage} ms" for stage in STAGES))
    for count, row in zip(counts, rows, strict=True):
        table.add_row(str(count), *(f"{1e3 * seconds:.2f}" for seconds in row))
    return table


def draw(rates: dict[str, dict[int, float]], counts: list[int], curves: dict[str, Array]) -> None:
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4))
    for what, rate in rates.items():
        left.plot(list(rate), [value / rate[1] for value in rate.values()], marker="o", label=what)
    left.plot([1, 2], [1, 2], color="grey", linestyle=":", label="twice as many with two")
    left.set(xlabel="at once", ylabel="plans per second, to those of one", ylim=(0, None), xticks=(1, 2, 4))
    left.legend()
    for (where, rows), line in zip(curves.items(), ("--", "-"), strict=True):
        for stage, column, color in zip(STAGES, rows.T, ("grey", "tab:blue", "tab:orange", "black"), strict=True):
            right.plot(counts, 1e3 * column, line, color=color, marker="o", label=f"{stage}, {where}")
    right.set(xlabel="objects", ylabel="ms, median", xscale="log", yscale="log")
    right.legend(fontsize=7)
    figure.tight_layout()
    PLOT.parent.mkdir(exist_ok=True)
    figure.savefig(PLOT, dpi=110)


if __name__ == "__main__":
    main()
