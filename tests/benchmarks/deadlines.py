"""How late the planner answers after its timeout: `python tests/benchmarks/deadlines.py [--count 40] [--busy 2] [--seed 0]`.

Requests of every kind with a timeout drawn from all that they take, so that it passes in every stage of planning, beside `--busy`
processes that do nothing but compute. Prints for each kind how many were not answered with a plan in time, and how long after
the timeout (ms, wall clock) the answer was ready to be sent: the 95th percentile and the worst. An answer before it counts as 0.
`--busy 0` shows what the planner itself adds. The panda among posts, in this process.
"""

from __future__ import annotations

import argparse
import gc
import multiprocessing
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from rich.console import Console
from rich.table import Table

from zarm_contract.codec import encode
from zarm_contract.errors import ZarmError
from zarm_contract.messages import (
    AddObjects,
    AttachObject,
    ClearScene,
    Cuboid,
    Cylinder,
    JointGoal,
    Mesh,
    PathConstraint,
    PlanRequest,
    PointCloud,
    PoseGoal,
    SceneEdit,
    SceneObject,
    WaypointsGoal,
)
from zarm_contract.robot import load_robot
from zarm_geometry.frames import pose_of
from zarm_geometry.meshes import Meshes
from zarm_geometry.robot_model import RobotModel
from zarm_planner.handlers import Handlers
from zarm_planner.scene.store import SceneStore

SIDE = np.array((1.0, 0.4, 0.0, -1.6, 0.0, 2.0, 0.8))
OTHER = SIDE * (-1, 1, 1, 1, 1, 1, 1)
POSTS = tuple(
    Cylinder(kind="cylinder", name=f"post{k}", position=(x, y, 0.3), radius=0.03, length=0.6)
    for k, (x, y) in enumerate(((0.55, 0.0), (0.45, 0.3), (0.45, -0.3)))
)
CLOSED = tuple(
    Cuboid(kind="cuboid", name=f"wall{k}", position=place, size=size)
    for k, (place, size) in enumerate(
        (
            ((0.6, 0.0, 0.5), (1.2, 0.02, 3.0)),
            ((-0.6, 0.0, 0.5), (1.0, 0.02, 3.0)),
            ((0.0, 0.0, 1.15), (1.0, 0.02, 0.2)),
        )
    )
)
KEEP_UPRIGHT = PathConstraint(axes=(True, True, False, False, False, False), angle_tolerance=0.1)
QUEUED = 16
"""Requests that are in hand at once in the kind of that name."""


def main() -> None:
    """Print one table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=40, help="requests of each kind")
    parser.add_argument("--busy", type=int, default=2, help="processes that compute all the time")
    parser.add_argument("--seed", type=int, default=0, help="of the timeouts")
    options = parser.parse_args()
    context = multiprocessing.get_context("spawn")
    busy = [context.Process(target=_compute, daemon=True) for _ in range(options.busy)]
    table = Table("kind", "takes ms", "not in time", "late p95 ms", "late worst ms")
    random = np.random.default_rng(options.seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        model = RobotModel.of(load_robot("panda"))
        _ball(6).export(folder / "ball.stl")
        planner = Handlers(model, "panda", SceneStore(folder / "state", Meshes([folder])), lambda: OTHER)
        planner.warm_up(lambda _: None)
        gc.collect()
        gc.freeze()  # as the service does
        for process in busy:
            process.start()
        for kind, objects, request in _kinds(model):
            _set(planner, kind, objects)
            takes = _answer(planner, request, 20.0)[0]
            timeouts = random.uniform(0.002, min(takes, 3.0) * 1.2, options.count).tolist()
            with ThreadPoolExecutor(QUEUED if kind == "queued" else 1) as threads:
                answers = [*threads.map(lambda s, r=request: (s, *_answer(planner, r, s)), timeouts)]
            late = 1e3 * np.array([max(took - timeout, 0.0) for timeout, took, _ in answers])
            missed = sum(not found for *_, found in answers)
            table.add_row(
                kind, f"{1e3 * takes:.0f}", str(missed), f"{np.percentile(late, 95):.0f}", f"{late.max():.0f}"
            )
        planner.close()
        for process in busy:
            process.terminate()
    Console(width=100).print(table)


def _kinds(model: RobotModel) -> list[tuple[str, tuple[SceneObject | PointCloud, ...], PlanRequest]]:
    """Each kind of request by name, with the scene that it is made in."""
    start = tuple(OTHER.tolist())

    def asked(goal: PoseGoal | JointGoal | WaypointsGoal, **options: Any) -> PlanRequest:
        return PlanRequest(goal=goal, start=start, **{"optimize_s": 0.0, **options})

    def pose(q: np.ndarray) -> PoseGoal:
        at = pose_of(model.fk_tip(q))
        return PoseGoal(kind="pose", position=at.position, orientation=at.orientation)

    joints = JointGoal(kind="joints", position=tuple(SIDE.tolist()))
    stops = [pose(SIDE * (turn, 1, 1, 1, 1, 1, 1)) for turn in np.linspace(-0.9, 1.0, 12)]
    many = stops[-1].model_copy(update={"alternatives": tuple(stop.poses[0] for stop in stops[:-1])})
    through = WaypointsGoal(kind="waypoints", through=tuple(stops))
    hull = {"position": (0.55, 0.0, 0.45), "orientation": (0.0, 0.0, 0.0, 1.0)}
    mesh = Mesh(kind="mesh", name="ball", file="ball.stl", **hull)
    points = trimesh.sample.sample_surface(_ball(6), 50_000, seed=0)[0].tolist()
    cloud = PointCloud(kind="cloud", name="cloud", resolution=0.005, points=tuple(map(tuple, points)), **hull)
    tool = Cuboid(
        kind="cuboid", name="tool", position=tuple(model.fk_tip(OTHER)[:3, 3].tolist()), size=(0.04, 0.04, 0.1)
    )
    return [
        ("path constraint", (), asked(stops[-1], path_constraint=KEEP_UPRIGHT)),  # first: TOPPRA is not loaded yet
        ("path constraint, optimised", (), asked(stops[-1], path_constraint=KEEP_UPRIGHT, optimize_s=0.3)),
        ("joints", POSTS, asked(joints)),
        ("pose", POSTS, asked(stops[-1])),
        ("goal set", POSTS, asked(many)),
        ("waypoints", (), asked(through)),
        ("waypoints, slowly", (), asked(through, velocity_scale=0.02)),
        ("optimised", POSTS, asked(joints, optimize_s=0.5)),
        ("optimised, large margin", POSTS, asked(joints, optimize_s=0.5, self_margin=0.2)),
        ("no way", CLOSED, asked(joints)),
        ("attached", (*POSTS, tool), asked(joints)),
        ("mesh", (mesh,), asked(joints)),
        ("cloud", (cloud,), asked(joints)),
        ("mesh, another margin each", (mesh,), asked(joints, margin=0.01)),
        ("queued", POSTS, asked(joints, optimize_s=0.2)),
    ]


def _set(planner: Handlers, kind: str, objects: tuple[SceneObject | PointCloud, ...]) -> None:
    planner.edit(SceneEdit(edit=ClearScene(op="clear")))
    if objects:
        planner.edit(SceneEdit(edit=AddObjects(op="add", objects=objects)))
    if kind == "attached":
        joints = tuple(OTHER.tolist())
        planner.edit(SceneEdit(edit=AttachObject(op="attach", name="tool", touch_links=("panda_hand",), joints=joints)))


def _answer(planner: Handlers, request: PlanRequest, timeout: float) -> tuple[float, bool]:
    """Seconds until the answer is ready to be sent, and whether it is a plan."""
    began, found = time.perf_counter(), False
    with suppress(ZarmError):
        encode(planner.plan(request.model_copy(update={"timeout": timeout, "seed": int(1e6 * timeout)})))
        found = True
    return time.perf_counter() - began, found


def _ball(subdivisions: int) -> trimesh.Trimesh:
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=1.0)
    x, y, z = ball.vertices.T
    bumps = 1.0 + 0.3 * np.sin(5 * x) * np.sin(7 * y) * np.sin(6 * z)
    return trimesh.Trimesh(0.2 * ball.vertices * bumps[:, None], ball.faces)


def _compute() -> None:
    while True:
        pass


if __name__ == "__main__":
    main()
