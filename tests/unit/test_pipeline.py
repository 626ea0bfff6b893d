"""What the pipeline promises as a whole: of the ways to a goal a short one, verified, and the same for the same seed."""

from __future__ import annotations

import numpy as np
import pytest

from zarm_contract.errors import PlanningFailed
from zarm_contract.messages import Cylinder, JointGoal, PoseGoal, SceneObject, Sphere
from zarm_contract.robot import load_robot
from zarm_planner.ends import Snapshot
from zarm_planner.exact import ExactScene
from zarm_planner.frames import pose_of
from zarm_planner.motion import Limits
from zarm_planner.pipeline import Found, plan
from zarm_planner.robot_model import RobotModel
from zarm_planner.stop import Stop
from zarm_planner.world import World

HOME = np.array([0.0, 0.0, 1.5708, 0.0, 1.5708, 0.0])
SWUNG = HOME + [1.3, 0, 0, 0, 0, 0]


@pytest.fixture(scope="module")
def model() -> RobotModel:
    return RobotModel.of(load_robot("doosan_m1013"))


def post(model: RobotModel) -> SceneObject:
    """In the way of the tool, half-way between HOME and SWUNG."""
    x, y, z = model.fk_tip((HOME + SWUNG) / 2)[:3, 3].tolist()
    return Cylinder(kind="cylinder", name="post", position=(x, y, z - 0.1), radius=0.04, length=0.4)


def snapshot(model: RobotModel, *objects: SceneObject) -> Snapshot:
    world = World(objects, 0.005)
    return Snapshot(1, model, world, ExactScene(model, world))


def to_pose(model: RobotModel, joints: np.ndarray, *objects: SceneObject, seed: int = 0) -> Found:
    pose = pose_of(model.fk_tip(joints))
    goal = PoseGoal(kind="pose", position=pose.position, orientation=pose.orientation)
    return plan(snapshot(model, *objects), HOME, goal, Limits.of(model), seed, Stop(60.0))


@pytest.mark.parametrize("seed", range(5))
def test_a_detour_to_a_near_posture_is_taken_before_the_straight_way_to_a_far_one(model: RobotModel, seed: int) -> None:
    straight = plan(
        snapshot(model), HOME, JointGoal(kind="joints", position=tuple(SWUNG)), Limits.of(model), 0, Stop(60)
    )
    found = to_pose(model, SWUNG, post(model), seed=seed)
    assert found.motion.length < 2.5 * straight.motion.length
    assert np.ptp(found.motion.position[:, 0]) < np.pi


def test_without_anything_in_the_way_the_nearest_posture_is_reached_straight(model: RobotModel) -> None:
    found = to_pose(model, SWUNG)
    np.testing.assert_allclose(found.motion.position[-1], SWUNG, atol=1e-5)
    assert found.motion.length == pytest.approx(1.3, abs=1e-3)


def test_the_same_seed_gives_the_same_motion(model: RobotModel) -> None:
    first, again = (to_pose(model, SWUNG, post(model), seed=3) for _ in range(2))
    np.testing.assert_array_equal(first.motion.position, again.motion.position)


def test_a_goal_inside_an_object_is_refused_at_once(model: RobotModel) -> None:
    x, y, z = model.fk_tip(SWUNG)[:3, 3].tolist()
    lump = Sphere(kind="sphere", name="lump", position=(x, y, z), radius=0.2)
    with pytest.raises(PlanningFailed) as refused:
        to_pose(model, SWUNG, lump)
    assert refused.value.code == "goal_in_collision"
    assert "lump" in str(refused.value)
