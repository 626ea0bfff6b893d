"""What meshes of many triangles and clouds of many points cost: `python tests/benchmarks/fine_scenes.py [--plans 20]`.

Panda plans around a bumpy ball of 0.2 m radius in its way, as a mesh of more and more triangles, and as a cloud of points on
it; around a lathed part, whose triangles are long and thin; and before a rough wall, an open surface like that of a scan. Times are CPU time of this process: of the edit that adds the object, from its JSON on and with what it makes ready, and of plans to joints with
`optimize_s` 0, the first one after the edit and the median of the others. Needs the robot in ../shared/mbm.
"""

from __future__ import annotations

import argparse
import gc
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.planner import motion_bench
from zarm_contract.codec import decode, encode
from zarm_contract.messages import AddObjects, JointGoal, Mesh, PlanRequest, PointCloud, SceneEdit, SceneObject
from zarm_geometry.meshes import Meshes
from zarm_geometry.robot_model import RobotModel
from zarm_planner.handlers import Handlers
from zarm_planner.scene.store import SceneStore
from zarm_planner.service import NEW_OBJECTS

RADIUS = 0.2
AT = (0.55, 0.0, 0.45)
UPRIGHT = (0.0, 0.0, 0.0, 1.0)
SIDE = (1.0, 0.6, 0.0, -1.2, 0.0, 1.8, 0.8)
SUBDIVISIONS = (2, 3, 4, 5, 6)
SECTIONS = (18, 6200)
SQUARES = (12, 223)
POINTS = (1_000, 10_000, 100_000)


def main() -> None:
    """Print one table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plans", type=int, default=20, help="plans with each object")
    options = parser.parse_args()
    if not motion_bench.AVAILABLE:
        sys.exit(f"there is nothing to measure: MotionBenchMaker's robots are not in {motion_bench.PROBLEMS}")
    table = Table("object", "edit ms", "first plan ms", "other plans ms", "to the coarsest")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        model = RobotModel.of(motion_bench.robot("panda", folder))
        meshes = folder / "meshes"
        meshes.mkdir()
        planner = Handlers(model, "panda", SceneStore(folder / "state", Meshes([meshes])), lambda: np.zeros(model.dof))
        planner.warm_up(lambda _: None)
        gc.collect()
        gc.freeze()  # as the service does
        gc.set_threshold(NEW_OBJECTS)
        for objects in (
            [_mesh(meshes, "ball", _ball(count), AT) for count in SUBDIVISIONS],
            [_mesh(meshes, "lathed part", _lathed(count), (0.5, 0.0, 0.3)) for count in SECTIONS],
            [_mesh(meshes, "rough wall", _wall(count), (0.0, 0.0, 0.0)) for count in SQUARES],
            [_cloud(count) for count in POINTS],
        ):
            coarsest = 0.0
            for what, item in objects:
                edit, first, rest = _costs(planner, item, options.plans)
                coarsest = coarsest or rest
                table.add_row(what, f"{edit:.0f}", f"{first:.1f}", f"{rest:.1f}", f"{rest / coarsest:.2f}")
        planner.close()
    Console(width=100).print(table)


def _costs(planner: Handlers, item: SceneObject | PointCloud, plans: int) -> tuple[float, float, float]:
    """Milliseconds of the edit, of the first plan after it, and the median of the other plans."""
    content = encode(SceneEdit(edit=AddObjects(op="add", objects=(item,), replace=True)))
    gc.collect(0)  # the points made above are not the service's
    edit = _cpu_ms(lambda: planner.edit(decode(SceneEdit, content)))
    goal, start = JointGoal(kind="joints", position=SIDE), (-SIDE[0], *SIDE[1:])
    times = []
    for seed in range(plans):
        request = PlanRequest(goal=goal, start=start, optimize_s=0.0, seed=seed)
        times.append(_cpu_ms(lambda request=request: planner.plan(request)))
    return edit, times[0], float(np.median(times[1:]))


def _cpu_ms(work: Callable[[], object]) -> float:
    began = time.process_time()
    work()
    return (time.process_time() - began) * 1e3


def _ball(subdivisions: int) -> trimesh.Trimesh:
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=1.0)
    x, y, z = ball.vertices.T
    bumps = 1.0 + 0.3 * np.sin(5 * x) * np.sin(7 * y) * np.sin(6 * z)
    return trimesh.Trimesh(ball.vertices * bumps[:, None] * RADIUS, ball.faces)


def _lathed(sections: int) -> trimesh.Trimesh:
    rod = trimesh.creation.cylinder(radius=0.06, height=0.6, sections=sections)
    flange = trimesh.creation.cylinder(radius=0.12, height=0.03, sections=sections)
    ring = trimesh.creation.annulus(r_min=0.1, r_max=0.16, height=0.05, sections=sections)
    flange.apply_translation((0.0, 0.0, 0.1))
    ring.apply_translation((0.0, 0.0, 0.25))
    return trimesh.util.concatenate([rod, flange, ring])


def _wall(squares: int) -> trimesh.Trimesh:
    u, v = np.meshgrid(np.linspace(-1.0, 1.0, squares + 1), np.linspace(0.0, 1.2, squares + 1), indexing="ij")
    x = 0.75 + 0.03 * np.sin(9 * u) * np.sin(11 * v) + 0.001 * np.random.default_rng(1).standard_normal(u.shape)
    corner = np.arange(u.size).reshape(u.shape)
    a, b, c, d = (part.ravel() for part in (corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]))
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    return trimesh.Trimesh(np.stack([x, 0.8 * u, v], axis=-1).reshape(-1, 3), faces)


def _mesh(folder: Path, what: str, shape: trimesh.Trimesh, at: tuple[float, float, float]) -> tuple[str, Mesh]:
    file = f"{what}-{len(shape.faces)}.stl"
    shape.export(folder / file)
    item = Mesh(kind="mesh", name="thing", file=file, position=at, orientation=UPRIGHT)
    return f"{what}, {len(shape.faces)} triangles", item


def _cloud(count: int) -> tuple[str, PointCloud]:
    points, _ = trimesh.sample.sample_surface(_ball(6), count, seed=0)
    item = PointCloud(
        kind="cloud",
        name="thing",
        resolution=0.005,
        points=tuple(map(tuple, points.tolist())),
        position=AT,
        orientation=UPRIGHT,
    )
    return f"cloud of {count} points", item


if __name__ == "__main__":
    main()
