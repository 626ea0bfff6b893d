"""Goal sets: of several poses the planner goes to the one that it reaches in the shortest time."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from support.planner import second_opinion
from zarm_contract.errors import InvalidRequest, PlanningFailed
from zarm_contract.messages import Cylinder, PathConstraint, Pose, PoseGoal, SceneObject, Sphere, WaypointsGoal
from zarm_contract.robot import load_robot
from zarm_geometry.exact import ExactScene
from zarm_geometry.frames import pose_of
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.context import PlanningContext
from zarm_planner.deadline import Deadline
from zarm_planner.pipeline import Verified, plan
from zarm_planner.planners.registry import choose
from zarm_planner.scene.planning_scene import PlanningScene
from zarm_trajectory.limits import Limits

MODELS = {name: RobotModel.of(load_robot(name)) for name in ("doosan_m1013", "panda")}
PANDA = MODELS["panda"]
HOME = np.array(PANDA.robot.descriptor.home)
FAR = Pose(position=(3.0, 0.0, 0.5))
TOLERANCE = 1.1
"""A search is left to chance: the quickest of a set may take so much longer than the quickest of all plans to each pose alone."""


def planned(
    model: RobotModel,
    goal: PoseGoal | WaypointsGoal,
    *objects: SceneObject,
    held: PathConstraint | None = None,
) -> Verified:
    world = World(objects, 0.005)
    scene = PlanningScene("1-000000000000", model, world, ExactScene(model, world))
    context = PlanningContext(scene, Limits.of(model.robot), Deadline(60.0), held)
    return plan(choose("auto", goal, held is not None), context, np.array(model.robot.descriptor.home), goal)


def any_of(*poses: Pose) -> PoseGoal:
    return PoseGoal(kind="pose", position=poses[0].position, orientation=poses[0].orientation, alternatives=poses[1:])


def tip_at(model: RobotModel, q: NDArray[np.float64]) -> Pose:
    return pose_of(model.fk_tip(q))


def post_on_the_way(model: RobotModel, q: NDArray[np.float64]) -> SceneObject:
    home = np.array(model.robot.descriptor.home)
    x, y, z = model.fk_tip((home + q) / 2)[:3, 3].tolist()
    return Cylinder(kind="cylinder", name="post", position=(x, y, z), radius=0.03, length=0.3)


@pytest.mark.lengthy
@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("blocked", [False, True])
def test_the_chosen_pose_is_the_quickest_by_its_own_plan(name: str, blocked: bool) -> None:
    model = MODELS[name]
    home = np.array(model.robot.descriptor.home)
    random = np.random.default_rng(7)
    away = home + random.uniform(-0.9, 0.9, (5, model.dof))
    away = np.clip(away, model.lower, model.upper)
    free = [tip_at(model, q) for q in away if second_opinion_free(model, q)]
    objects = (post_on_the_way(model, away[0]),) if blocked else ()
    alone = []
    for pose in free:
        try:
            alone.append(planned(model, any_of(pose), *objects).trajectory.duration)
        except PlanningFailed:
            alone.append(np.inf)
    chosen = planned(model, any_of(*free), *objects)
    assert chosen.goal_pose is not None
    assert chosen.trajectory.duration <= TOLERANCE * min(alone)
    assert alone[chosen.goal_pose] <= TOLERANCE * min(alone)
    reached = free[chosen.goal_pose]
    assert second_opinion.tip_error(
        model.robot, chosen.trajectory.end, reached.position, reached.orientation
    ) == pytest.approx((0.0, 0.0), abs=1e-5)


def second_opinion_free(model: RobotModel, q: NDArray[np.float64]) -> bool:
    return not second_opinion.Collisions(model.robot, ()).at(q)


def test_a_goal_without_alternatives_reports_its_pose() -> None:
    assert planned(PANDA, any_of(tip_at(PANDA, HOME + 0.2))).goal_pose == 0


def test_unreachable_and_colliding_poses_are_left_out() -> None:
    near, other = tip_at(PANDA, HOME + [0.6, 0, 0, 0, 0, 0, 0]), tip_at(PANDA, HOME - [0.9, 0, 0, 0, 0, 0, 0])
    ball = Sphere(kind="sphere", name="ball", position=near.position, radius=0.1)
    assert planned(PANDA, any_of(FAR, near, other)).goal_pose == 1
    assert planned(PANDA, any_of(FAR, near, other), ball).goal_pose == 2


def test_where_no_pose_is_left_the_error_says_why_for_each() -> None:
    near = tip_at(PANDA, HOME + [0.6, 0, 0, 0, 0, 0, 0])
    ball = Sphere(kind="sphere", name="ball", position=near.position, radius=0.1)
    with pytest.raises(
        PlanningFailed, match=r"pose 0 cannot be reached: .* pose 1 is in all .* inside ball"
    ) as refused:
        planned(PANDA, any_of(FAR, near), ball)
    assert (refused.value.code, refused.value.problem.field) == ("goal_in_collision", "goal")
    with pytest.raises(PlanningFailed, match="pose 1 cannot be reached") as refused:
        planned(PANDA, any_of(FAR, FAR))
    assert refused.value.code == "unreachable"


def test_a_pose_that_breaks_the_path_constraint_is_left_out() -> None:
    level = PathConstraint(axes=(False, False, False, False, False, True))
    start = tip_at(PANDA, HOME)
    x, y, z = start.position
    higher = Pose(position=(x, y, z + 0.1), orientation=start.orientation)
    aside = Pose(position=(x, y + 0.1, z), orientation=start.orientation)
    assert planned(PANDA, any_of(higher, aside), held=level).goal_pose == 1
    with pytest.raises(InvalidRequest, match="pose 0 breaks the path constraint"):
        planned(PANDA, any_of(higher, higher), held=level)


def test_a_waypoint_may_be_a_set_too() -> None:
    first, second = tip_at(PANDA, HOME + [0.4, 0, 0, 0, 0, 0, 0]), tip_at(PANDA, HOME + [0.8, 0.2, 0, 0, 0, 0, 0])
    found = planned(PANDA, WaypointsGoal(kind="waypoints", through=(any_of(FAR, first), any_of(FAR, second, first))))
    assert found.goal_pose == 2  # where it is already
    assert len(found.waypoint_times) == 2
    assert found.waypoint_times[-1] == pytest.approx(found.trajectory.duration, abs=0.005)
