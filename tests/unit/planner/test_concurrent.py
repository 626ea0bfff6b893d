"""A group is planned among a motion of other joints: neither waits longer than it must, and they never meet."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest

from support.composed import two_pandas
from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Goal, JointGoal, Plan, PlanRequest, PoseGoal, StartState, Trajectory
from zarm_contract.robot import RobotDescription, load_robot
from zarm_geometry.exact import ExactScene
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.handlers import Handlers
from zarm_planner.scene.store import SceneStore
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

LEFT, RIGHT = slice(7), slice(7, 14)
DOWN = (1.0, 0.0, 0.0, 0.0)


def described() -> RobotDescription:
    with tempfile.TemporaryDirectory() as folder:
        return load_robot(str(two_pandas(Path(folder))))


MODEL = RobotModel.of(described())
HOME = np.array(MODEL.robot.descriptor.home)
JOINTS = MODEL.robot.descriptor.joints


@pytest.fixture
def pandas(tmp_path: Path) -> Handlers:
    return Handlers(MODEL, "pandas", SceneStore(tmp_path), lambda: HOME)


def to(x: float, y: float, z: float) -> PoseGoal:
    return PoseGoal(kind="pose", position=(x, y, z), orientation=DOWN)


def plan(pandas: Handlers, goal: Goal, group: str, **fields: object) -> Plan:
    return pandas.plan(PlanRequest(goal=goal, group=group, optimize_s=0.0, **fields))  # type: ignore[arg-type]


def motion(one: Plan) -> TimedTrajectory:
    return TimedTrajectory.of(one.trajectory, JOINTS)


def checked(together: Plan, alone: Plan, standing: Array) -> float:
    """When the right arm begins (s) in a motion that keeps the limits, touches nothing, and has the left arm as in its plan `alone`."""
    both, left = motion(together), motion(alone)
    Limits.of(MODEL.robot).check(both)
    times = np.linspace(0.0, both.duration, 4000)
    states = both.sample(times)
    assert ExactScene(MODEL, World((), 0.0)).nearest(states[0]).distance > 0.0
    expected = left.sample(np.clip(times, 0.0, left.duration))[:, :, LEFT]
    np.testing.assert_allclose(states[:, :, LEFT], expected, atol=1e-6)
    return float(times[np.abs(states[0][:, RIGHT] - standing[RIGHT]).max(axis=1) > 1e-5][0])


def test_arms_that_stay_apart_move_at_once(pandas: Handlers) -> None:
    left = plan(pandas, to(0.45, 0.45, 0.4), "left")
    both = plan(pandas, to(0.45, -0.45, 0.4), "right", concurrent=left.trajectory)
    assert checked(both, left, HOME) < 0.1
    assert motion(both).duration == pytest.approx(
        max(motion(left).duration, motion(plan(pandas, to(0.45, -0.45, 0.4), "right")).duration), rel=0.2
    )
    assert both.clearance > 0.0


def test_an_arm_waits_until_the_other_is_out_of_its_way(pandas: Handlers) -> None:
    there = motion(plan(pandas, to(0.5, -0.05, 0.35), "left")).end
    back = plan(
        pandas, JointGoal(kind="joints", position=tuple(HOME[LEFT])), "left", start=tuple(there), velocity_scale=0.3
    )
    both = plan(pandas, to(0.5, -0.05, 0.35), "right", start=tuple(there), concurrent=back.trajectory)
    begins = checked(both, back, there)
    assert 0.1 < begins < motion(back).duration
    assert both.tip.position == pytest.approx((0.5, -0.05, 0.35), abs=1e-4)
    np.testing.assert_allclose(motion(both).end[LEFT], HOME[LEFT], atol=1e-6)


def test_the_rest_of_a_motion_under_way_goes_on_as_it_was(pandas: Handlers) -> None:
    left = motion(plan(pandas, to(0.45, 0.45, 0.4), "left"))
    rest = left.rest(0.4)
    both = motion(plan(pandas, to(0.45, -0.45, 0.4), "right", concurrent=rest.message(JOINTS)))
    np.testing.assert_allclose(both.at(0.0)[:, LEFT], left.at(0.4)[:, LEFT], atol=1e-9)
    times = np.linspace(0.0, rest.duration, 500)
    np.testing.assert_allclose(both.sample(times)[:, :, LEFT], left.sample(times + 0.4)[:, :, LEFT], atol=1e-6)


@pytest.mark.parametrize(
    ("fields", "field", "says"),
    [
        ({"group": None, "goal": JointGoal(kind="joints", position=tuple(HOME))}, "group", "name the group"),
        ({"group": "left"}, "concurrent.joint_names", "left_panda_joint1 moves there already"),
        (
            {"start_state": StartState(position=tuple(HOME), velocity=(0.0,) * 14, acceleration=(0.0,) * 14)},
            "start_state",
            "at rest",
        ),
    ],
)
def test_what_cannot_be_planned_beside_is_refused(
    pandas: Handlers, fields: dict[str, object], field: str, says: str
) -> None:
    rest = np.stack((HOME, HOME + 0.1))
    moved = TimedTrajectory(np.array([0.0, 1.0]), rest, np.zeros_like(rest), np.zeros_like(rest)).message(JOINTS)
    asked = {"goal": to(0.45, -0.45, 0.4), "group": "right", "concurrent": moved, **fields}
    with pytest.raises(InvalidRequest, match=says) as refused:
        pandas.plan(PlanRequest(**asked))  # type: ignore[arg-type]
    assert refused.value.problem.field == field


def test_a_joint_that_the_robot_lacks_is_named(pandas: Handlers) -> None:
    two = ((0.0,), (0.1,))
    odd = Trajectory(
        joint_names=("elbow",), time=(0.0, 1.0), position=two, velocity=((0.0,),) * 2, acceleration=((0.0,),) * 2
    )
    with pytest.raises(InvalidRequest, match="elbow is none of the joints"):
        plan(pandas, to(0.45, -0.45, 0.4), "right", concurrent=odd)
