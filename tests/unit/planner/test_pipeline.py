"""What the pipeline promises as a whole: of the ways to a goal a short one, verified, and the same for the same seed."""

from __future__ import annotations

import math
import time
from pathlib import Path

import numpy as np
import pytest

from support.planner.small_arm import DESCRIPTOR, URDF
from support.planner.unchecked_pairs import JOINTS, unchecked_pairs
from zarm_contract.errors import PlanningFailed
from zarm_contract.messages import Cuboid, Cylinder, JointGoal, PoseGoal, SceneObject, Sphere, WaypointsGoal
from zarm_contract.robot import load_robot
from zarm_geometry.exact import ExactScene
from zarm_geometry.frames import pose_of
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.context import PlanningContext
from zarm_planner.deadline import Deadline
from zarm_planner.goals.ends import End
from zarm_planner.goals.problem import PlanningProblem
from zarm_planner.kernels.leg_times import path_time
from zarm_planner.pipeline import Verified, plan
from zarm_planner.planners.free import FreePlanner
from zarm_planner.planners.route import _quickest_chain, find_route
from zarm_planner.scene.planning_scene import PlanningScene
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits

HOME = np.array([0.0, 0.0, 1.5708, 0.0, 1.5708, 0.0])
SWUNG = HOME + [1.3, 0, 0, 0, 0, 0]


@pytest.fixture(scope="module")
def model() -> RobotModel:
    return RobotModel.of(load_robot("doosan_m1013"))


def post(model: RobotModel) -> SceneObject:
    """In the way of the tool, half-way between HOME and SWUNG."""
    x, y, z = model.fk_tip((HOME + SWUNG) / 2)[:3, 3].tolist()
    return Cylinder(kind="cylinder", name="post", position=(x, y, z - 0.1), radius=0.04, length=0.4)


def snapshot(model: RobotModel, *objects: SceneObject) -> PlanningScene:
    world = World(objects, 0.005)
    return PlanningScene("1-000000000000", model, world, ExactScene(model, world))


def context(model: RobotModel, *objects: SceneObject, timeout: float = 60.0, **options: float) -> PlanningContext:
    return PlanningContext(snapshot(model, *objects), Limits.of(model.robot), Deadline(timeout), **options)


def to_pose(model: RobotModel, joints: np.ndarray, *objects: SceneObject, seed: int = 0) -> Verified:
    pose = pose_of(model.fk_tip(joints))
    goal = PoseGoal(kind="pose", position=pose.position, orientation=pose.orientation)
    return plan(FreePlanner(), context(model, *objects, seed=seed), HOME, goal)


@pytest.mark.parametrize("seed", range(5))
def test_a_detour_to_a_near_posture_beats_a_far_straight_way(model: RobotModel, seed: int) -> None:
    straight = plan(FreePlanner(), context(model), HOME, JointGoal(kind="joints", position=tuple(SWUNG)))
    found = to_pose(model, SWUNG, post(model), seed=seed)
    assert found.trajectory.length < 2.5 * straight.trajectory.length
    assert np.ptp(found.trajectory.position[:, 0]) < np.pi


class _Overshooting:
    """Paths along the first joint, of which the one to 1 rad overshoots; `searched` are their goals and time limits."""

    def __init__(self, overshoot: float) -> None:
        self.overshoot, self.searched = overshoot, list[tuple[float, float]]()

    def between(self, start: Array, goal: Array, within: float, *, alone: bool) -> Array | None:
        self.searched.append((float(goal[0]), within))
        beyond = goal + (self.overshoot, 0, 0, 0, 0, 0)
        return np.array([start, beyond, goal] if goal[0] == 1.0 else [start, goal])

    def to_any(self, start: Array, goals: Array, until: Deadline) -> Array | None:
        return None


@pytest.mark.parametrize(("overshoot", "goals"), [(0.0, [1.0]), (0.007, [1.0]), (0.2, [1.0, 1.01])])
def test_a_further_leg_is_searched_only_if_worth_it(model: RobotModel, overshoot: float, goals: list[float]) -> None:
    limits, paths = Limits.of(model.robot), _Overshooting(overshoot)
    start, *ends = (End.at(np.array((q, 0.0, 0.0, 0.0, 0.0, 0.0))) for q in (0.0, 1.0, 1.01, 2.0))
    chain = _quickest_chain(paths, [[start], ends], limits)
    assert chain is not None
    assert [goal for goal, _ in paths.searched] == goals
    assert chain[0][0].asked[0] == goals[-1]
    first = np.array([start.free, ends[0].free + (overshoot, 0, 0, 0, 0, 0), ends[0].free])
    took = path_time(first, limits.velocity, limits.acceleration, 2)
    assert [within for _, within in paths.searched] == [math.inf, took][: len(goals)]


class _Fruitless:
    """Finds no path; the first search lasts `until` its deadline if it is `slow`. `deadlines` (s) are those given."""

    def __init__(self, *, slow: bool) -> None:
        self.slow, self.deadlines = slow, list[float]()

    def between(self, start: Array, goal: Array, within: float, *, alone: bool) -> Array | None:
        return None

    def to_any(self, start: Array, goals: Array, until: Deadline) -> Array | None:
        self.deadlines.append(float(until.at[0]))
        while self.slow and len(self.deadlines) == 1 and not until.passed:
            pass
        return None


@pytest.mark.parametrize("slow", [False, True])
def test_a_search_pauses_for_a_proof_unless_given_up(model: RobotModel, slow: bool) -> None:
    paths, request = _Fruitless(slow=slow), context(model)
    problem = PlanningProblem.of(request, HOME, JointGoal(kind="joints", position=tuple(SWUNG)))
    began = time.monotonic()
    assert find_route(paths, problem, request) is None
    assert began + 0.3 <= paths.deadlines[0] < request.deadline.at[0]
    assert paths.deadlines[1:] == ([float(request.deadline.at[0])] if slow else [])


def test_in_free_space_the_nearest_posture_is_reached_straight(model: RobotModel) -> None:
    found = to_pose(model, SWUNG)
    np.testing.assert_allclose(found.trajectory.position[-1], SWUNG, atol=1e-5)
    assert found.trajectory.length == pytest.approx(1.3, abs=1e-3)


def test_the_same_seed_gives_the_same_motion(model: RobotModel) -> None:
    first, again = (to_pose(model, SWUNG, post(model), seed=3) for _ in range(2))
    np.testing.assert_array_equal(first.trajectory.position, again.trajectory.position)


def test_a_goal_inside_an_object_is_refused_at_once(model: RobotModel) -> None:
    x, y, z = model.fk_tip(SWUNG)[:3, 3].tolist()
    lump = Sphere(kind="sphere", name="lump", position=(x, y, z), radius=0.2)
    with pytest.raises(PlanningFailed) as refused:
        to_pose(model, SWUNG, lump)
    assert refused.value.code == "goal_in_collision"
    assert "lump" in str(refused.value)


@pytest.mark.parametrize(
    ("start", "goal", "expected"),
    [
        ("in it", "beside it", "start_in_collision"),
        ("beside it", "in it", "goal_in_collision"),
        ("in it", "in it", "start_in_collision"),
        ("in it", "nowhere", "start_in_collision"),
    ],
)
def test_an_end_in_collision_is_named_without_spheres_too(tmp_path: Path, start: str, goal: str, expected: str) -> None:
    thin = DESCRIPTOR.replace("rod: [{center: [0, 0, 0], radius: 0.03}]", "rod: [{center: [0, 0, 0], radius: 0.001}]")
    (tmp_path / "small_arm.urdf").write_text(URDF)
    (tmp_path / "small_arm.yaml").write_text(thin)
    model = RobotModel.of(load_robot(str(tmp_path / "small_arm.yaml")))
    q = {"in it": np.array((0.0, 0.5, 1.0, 0.1)), "beside it": np.array((0.5, 0.5, 1.0, 0.1))}
    x, y, z = model.fk_tip(q["in it"])[:3, 3].tolist()
    bead = Sphere(kind="sphere", name="bead", position=(x, y, z + 0.02), radius=0.005)
    asked: JointGoal | PoseGoal = PoseGoal(kind="pose", position=(9.0, 0.0, 0.0))
    if goal in q:
        asked = JointGoal(kind="joints", position=tuple(q[goal].tolist()))
    with pytest.raises(PlanningFailed, match=r"collision: rod is 1\d\.\d mm inside bead") as refused:
        plan(FreePlanner(), context(model, bead), q[start], asked)
    assert refused.value.code == expected
    assert refused.value.problem.field == ("goal" if expected == "goal_in_collision" else "start")


def test_a_pose_is_reached_by_a_solution_free_in_every_pair(tmp_path: Path) -> None:
    model = unchecked_pairs(tmp_path)
    pose = pose_of(model.fk_tip(JOINTS))
    goal = PoseGoal(kind="pose", position=pose.position, orientation=pose.orientation)
    for seed in range(5):
        request = context(model, max_attempts=5, seed=seed)
        assert plan(FreePlanner(), request, np.array(model.robot.descriptor.home), goal).clearance > 0.0


def test_no_budget_is_spent_on_a_motion_that_cannot_be_faster(model: RobotModel) -> None:
    goal = JointGoal(kind="joints", position=tuple(SWUNG))
    request = context(model, optimize_s=30.0)
    plan(FreePlanner(), request, HOME, goal)
    assert request.timer.timings().optimize < 1.0


@pytest.mark.lengthy
def test_the_deadline_returns_the_best_motion_so_far(model: RobotModel) -> None:
    through = (JointGoal(kind="joints", position=tuple(SWUNG)), JointGoal(kind="joints", position=tuple(HOME)))
    goal = WaypointsGoal(kind="waypoints", through=through)
    request = context(model, post(model), timeout=1.0, optimize_s=30.0)
    found = plan(FreePlanner(), request, HOME, goal)
    assert found.trajectory.duration > 0.0
    assert 0.0 < request.timer.timings().optimize < 30.0


def test_what_cannot_be_found_is_given_up_after_so_many_attempts(model: RobotModel) -> None:
    across = [(0.0, 0.0, np.sin(turn / 2), np.cos(turn / 2)) for turn in (1.0, -1.5)]
    walls = [
        Cuboid(
            kind="cuboid",
            name=f"wall_{i}",
            position=(1.4 * np.cos(turn), 1.4 * np.sin(turn), 0.0),
            orientation=across[i],
            size=(2.0, 0.02, 3.0),
        )
        for i, turn in enumerate((1.0, -1.5))
    ]
    # Between floor and roof the upper arm can neither stand up nor hang down to turn past a wall.
    plates = [
        Cuboid(kind="cuboid", name=f"plate_{i}", position=(0.0, 0.0, z), size=(4.0, 4.0, 0.02))
        for i, z in enumerate((-0.05, 0.6))
    ]
    low = np.array([0.0, 1.2, 0.5, 0.0, 0.0, 0.0])
    goal = JointGoal(kind="joints", position=(2.0, *low[1:].tolist()))
    with pytest.raises(PlanningFailed) as given_up:
        plan(FreePlanner(), context(model, *walls, *plates, max_attempts=1), low, goal)
    assert given_up.value.code == "no_path"
    assert "max_attempts, 1" in str(given_up.value)
