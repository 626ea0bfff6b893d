"""Messages from ROS and to it: units, quaternion order, empty fields, joint order by name, steps in time, and what is refused."""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import Point, Quaternion, Vector3
from geometry_msgs.msg import Pose as RosPose
from hypothesis import given
from hypothesis import strategies as st
from sensor_msgs.msg import JointState as RosJointState
from std_msgs.msg import ColorRGBA

from curobo_msgs.srv import AddObject, TrajectoryGeneration
from support.examples import examples
from zarm_contract.errors import InvalidRequest, PlanningFailed
from zarm_contract.messages import (
    Capsule,
    Cuboid,
    Cylinder,
    JointGoal,
    JointState,
    Mesh,
    Occupancy,
    PathConstraint,
    Pose,
    PoseGoal,
    Sphere,
    Trajectory,
    WaypointsGoal,
)
from zarm_ros_bridge.convert.colours import colour_of
from zarm_ros_bridge.convert.fields import in_terms_of
from zarm_ros_bridge.convert.joints import is_empty, positions_of, ros_joint_state, ros_positions
from zarm_ros_bridge.convert.poses import is_given, pose_of, ros_pose
from zarm_ros_bridge.convert.times import ros_time
from zarm_ros_bridge.convert.trajectories import ros_joint_states
from zarm_ros_bridge.curobo.generations.b import GenerationB
from zarm_ros_bridge.curobo.motion_requests import MotionRequest, path_constraint_of
from zarm_ros_bridge.curobo.objects import fill_grid, object_of
from zarm_trajectory.trajectory import TimedTrajectory


def promised(*values: st.SearchStrategy[Any]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """For fifty of these values."""
    return lambda test: examples(0.5)(given(*values)(test))


JOINTS = ("joint_1", "joint_2", "joint_3")
NO_NUMBER = [math.nan, math.inf, -math.inf]

numbers = st.floats(-1e3, 1e3)
vectors = st.tuples(numbers, numbers, numbers)
parts = st.floats(-1.0, 1.0)
turns = (
    st.tuples(parts, parts, parts, parts)
    .filter(lambda q: math.hypot(*q) > 0.1)
    .map(lambda q: tuple(x / math.hypot(*q) for x in q))
)
angles = st.tuples(*[st.floats(-6.3, 6.3)] * 3)


def placed(position: tuple[float, ...], q: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0)) -> RosPose:
    return RosPose(
        position=Point(x=position[0], y=position[1], z=position[2]),
        orientation=Quaternion(x=q[0], y=q[1], z=q[2], w=q[3]),
    )


def fault(work: Any, *arguments: Any) -> str:
    """The field that a refusal names; its message must be a sentence."""
    with pytest.raises(InvalidRequest) as raised:
        work(*arguments)
    assert len(raised.value.problem.message) > 15
    return raised.value.problem.field or ""


# -- poses --


@promised(vectors, turns)
def test_a_pose_survives_both_ways(
    position: tuple[float, float, float], turn: tuple[float, float, float, float]
) -> None:
    pose = Pose(position=position, orientation=turn)
    message = ros_pose(pose)
    assert (message.position.x, message.position.y, message.position.z) == position
    q = message.orientation
    assert (q.x, q.y, q.z, q.w) == pose.orientation
    assert pose_of(message, "pose") == pose


@promised(turns, st.floats(0.9991, 1.0009))
def test_a_quaternion_of_nearly_one_is_normalised(turn: tuple[float, ...], length: float) -> None:
    found = pose_of(placed((0.0, 0.0, 0.0), tuple(length * x for x in turn)), "pose").orientation
    np.testing.assert_allclose(found, turn, atol=1e-12)


@promised(turns, st.one_of(st.floats(0.01, 0.998), st.floats(1.002, 100.0)))
def test_any_other_quaternion_is_refused(turn: tuple[float, ...], length: float) -> None:
    assert fault(pose_of, placed((0.0, 0.0, 0.0), tuple(length * x for x in turn)), "pose") == "pose.orientation"


@promised(vectors)
def test_an_orientation_left_empty_is_none(position: tuple[float, ...]) -> None:
    assert pose_of(placed(position, (0.0, 0.0, 0.0, 0.0)), "pose") == Pose(position=position)


@pytest.mark.parametrize("value", NO_NUMBER)
@pytest.mark.parametrize("field", [f"position.{axis}" for axis in "xyz"] + [f"orientation.{axis}" for axis in "xyzw"])
def test_what_is_no_number_in_a_pose_is_named(field: str, value: float) -> None:
    message = placed((0.1, 0.2, 0.3))
    part, axis = field.split(".")
    setattr(getattr(message, part), axis, value)
    assert fault(pose_of, message, "target_poses[3]") == f"target_poses[3].{field}"


@promised(vectors, turns)
def test_only_a_pose_at_its_defaults_is_not_given(position: tuple[float, ...], turn: tuple[float, ...]) -> None:
    assert not is_given(RosPose())
    assert not is_given(placed((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)))
    assert is_given(placed(position)) == any(position)
    assert is_given(placed((0.0, 0.0, 0.0), turn)) == (turn != (0.0, 0.0, 0.0, 1.0))


# -- joints --


@promised(angles, st.permutations([*JOINTS, "gripper"]))
def test_joints_are_found_by_name_in_any_order_beside_others(position: tuple[float, ...], names: list[str]) -> None:
    values = dict(zip(JOINTS, position, strict=True)) | {"gripper": math.nan}
    message = RosJointState(name=names, position=[values[name] for name in names])
    assert positions_of(message, JOINTS, "start_pose") == position
    plain = RosJointState(name=[name.replace("_", "") for name in names], position=message.position)
    assert positions_of(plain, JOINTS, "start_pose") == position


@promised(angles)
def test_joints_without_names_are_in_the_order_of_the_robot(position: tuple[float, ...]) -> None:
    assert positions_of(RosJointState(position=position), JOINTS, "start_pose") == position


@promised(angles, angles, st.floats(0.0, 4e9))
def test_joints_survive_both_ways(position: tuple[float, ...], velocity: tuple[float, ...], stamp: float) -> None:
    message = ros_joint_state(JointState(stamp=stamp, joint_names=JOINTS, position=position, velocity=velocity))
    assert positions_of(message, JOINTS, "joints") == position
    assert tuple(message.velocity) == velocity
    assert message.header.stamp.sec + message.header.stamp.nanosec * 1e-9 == pytest.approx(stamp, abs=1e-6)
    assert positions_of(ros_positions(JOINTS, position), JOINTS, "joints") == position


@pytest.mark.parametrize(
    ("names", "position", "field"),
    [
        ([], [0.0, 0.0], "q.position"),
        ([], [0.0] * 4, "q.position"),
        (["joint_1", "joint_2"], [0.0, 0.0], "q.name"),
        (["joint_1", "joint_2", "joint_4"], [0.0] * 3, "q.name"),
        (["joint_1", "joint_2", "joint_3"], [0.0, 0.0], "q.position"),
        (["joint_1", "joint_2", "joint_3"], [], "q.position"),
        (["joint_1", "joint_2", "joint_3", "joint_1"], [0.0] * 4, "q.name.3"),
        (["joint_1", "joint1", "joint_2", "joint_3"], [0.0] * 4, "q.name.1"),
        (["joint_3", "joint_1", "joint_2"], [0.0, math.nan, 0.0], "q.position.1"),
        ([], [0.0, 0.0, math.inf], "q.position.2"),
    ],
)
def test_joints_that_fit_neither_are_refused(names: list[str], position: list[float], field: str) -> None:
    assert fault(positions_of, RosJointState(name=names, position=position), JOINTS, "q") == field


def test_joints_are_empty_only_without_names_and_positions() -> None:
    assert is_empty(RosJointState())
    assert not is_empty(RosJointState(name=["joint_1"]))
    assert not is_empty(RosJointState(position=[0.0]))


@promised(st.floats(-1e9, 4e9))
def test_a_time_of_ros_has_nanoseconds_from_zero_to_a_second(stamp: float) -> None:
    time = ros_time(stamp)
    assert 0 <= time.nanosec < 10**9
    assert time.sec + time.nanosec * 1e-9 == pytest.approx(stamp, abs=1e-6)


# -- goals --


def request(**fields: Any) -> TrajectoryGeneration.Request:
    return TrajectoryGeneration.Request(**fields)


def motion(asked: TrajectoryGeneration.Request, planner: str = "classic") -> MotionRequest:
    return GenerationB({}, ()).motion(asked, planner, JOINTS)


def constraint(asked: TrajectoryGeneration.Request, target: str) -> PathConstraint | None:
    each, count = asked.trajectories_contraints, len(asked.target_poses)
    return path_constraint_of(asked.trajectory_constraints, each, target, {"target_poses": count})


THERE = placed((0.5, 0.2, 0.3))
FILLED = {"target_pose": THERE, "target_poses": [THERE, THERE], "target_joint_positions": [0.1, 0.2, 0.3]}
READS = {
    "classic": "target_pose",
    "constrained": "target_pose",
    "batch": "target_poses",
    "multipoint": "target_poses",
    "joint_space": "target_joint_positions",
}


@pytest.mark.parametrize("planner", READS)
def test_a_planner_reads_its_goal_and_the_only_one_there_is(planner: str) -> None:
    assert motion(request(**FILLED), planner).field == READS[planner]
    for field, value in FILLED.items():
        assert motion(request(**{field: value}), planner).field == field
    assert fault(motion, request(), planner) == READS[planner]
    others = {field: value for field, value in FILLED.items() if field != READS[planner]}
    assert fault(motion, request(**others), planner) in others


def test_a_goal_is_what_its_field_says() -> None:
    pose = PoseGoal(kind="pose", position=(0.5, 0.2, 0.3))
    assert motion(request(**FILLED)).goal == pose
    assert motion(request(**FILLED), "multipoint").goal == WaypointsGoal(kind="waypoints", through=(pose, pose))
    assert motion(request(**FILLED), "batch").goal == pose.model_copy(
        update={"alternatives": (Pose(position=(0.5, 0.2, 0.3)),)}
    )
    assert motion(request(**FILLED), "joint_space").goal == JointGoal(kind="joints", position=(0.1, 0.2, 0.3))


@pytest.mark.parametrize(
    ("fields", "target", "field"),
    [
        ({"target_joint_positions": [0.1]}, "target_joint_positions", "target_joint_positions"),
        ({"target_joint_positions": [0.1, math.nan, 0.1]}, "target_joint_positions", "target_joint_positions[1]"),
        ({"target_poses": [THERE, placed((math.inf, 0.0, 0.0))]}, "target_poses", "target_poses[1].position.x"),
        ({"target_poses": [THERE] * 101}, "target_poses", "target_poses"),
        ({"target_pose": placed((0.1, 0.1, 0.1), (1.0, 1.0, 0.0, 0.0))}, "target_pose", "target_pose.orientation"),
    ],
)
def test_a_goal_that_cannot_be_is_named(fields: dict[str, Any], target: str, field: str) -> None:
    assert fault(motion, request(**fields)) == field


@promised(st.lists(st.integers(0, 1), min_size=6, max_size=6))
def test_the_axes_of_a_constraint_are_held_in_their_order(axes: list[int]) -> None:
    held = constraint(request(trajectory_constraints=axes), "target_pose")
    assert (held.axes if held else (False,) * 6) == tuple(map(bool, axes))
    same = constraint(request(target_poses=[THERE] * 3, trajectories_contraints=axes * 3), "target_poses")
    assert same == held


UPRIGHT, FREE = [1, 1, 0, 0, 0, 0], [0] * 6


@pytest.mark.parametrize(
    ("whole", "each", "target", "field"),
    [
        ([1, 1, 0], [], "target_pose", "trajectory_constraints"),
        (UPRIGHT * 2, [], "target_pose", "trajectory_constraints"),
        ([1, 1, 2, 0, 0, 0], [], "target_pose", "trajectory_constraints[2]"),
        ([-1, 0, 0, 0, 0, 0], [], "target_pose", "trajectory_constraints[0]"),
        ([], UPRIGHT, "target_pose", "trajectories_contraints"),
        ([], UPRIGHT, "target_poses", "trajectories_contraints"),
        ([], UPRIGHT + FREE, "target_poses", "trajectories_contraints"),
        (FREE, UPRIGHT + UPRIGHT, "target_poses", "trajectories_contraints"),
        ([], UPRIGHT + [0, 0, 0, 0, 0, 3], "target_poses", "trajectories_contraints[11]"),
    ],
)
def test_constraints_that_no_motion_can_keep_are_refused(
    whole: list[int], each: list[int], target: str, field: str
) -> None:
    asked = request(target_poses=[THERE] * 2, trajectory_constraints=whole, trajectories_contraints=each)
    assert fault(constraint, asked, target) == field


def test_constraints_of_zeros_hold_nothing() -> None:
    asked = request(target_poses=[THERE] * 2, trajectory_constraints=FREE, trajectories_contraints=FREE * 2)
    assert constraint(asked, "target_poses") is None
    assert constraint(asked, "target_pose") is None


def test_an_error_names_the_field_of_the_request() -> None:
    error = PlanningFailed("it cannot be reached", code="unreachable", field="goal.through.2")
    renamed = in_terms_of(error, {"goal.through": "target_poses", "goal": "target_pose"})
    assert (renamed.problem.field, renamed.code) == ("target_poses.2", "unreachable")
    assert isinstance(renamed, PlanningFailed)
    assert in_terms_of(error, {"go": "x"}) is error


# -- trajectories --

steps = st.lists(st.floats(0.001, 0.5), min_size=1, max_size=8)


@promised(steps, st.integers(0, 2**32 - 1), st.sampled_from([0.01, 0.02, 0.1]))
def test_a_trajectory_is_sampled_along_its_quintics(step: list[float], seed: int, dt: float) -> None:
    rng, count = np.random.default_rng(seed), len(step) + 1
    position, velocity, acceleration = rng.normal(size=(3, count, len(JOINTS)))
    velocity[-1] = acceleration[-1] = 0.0
    trajectory = Trajectory(
        joint_names=JOINTS,
        time=(0.0, *np.cumsum(step).tolist()),
        position=tuple(map(tuple, position.tolist())),
        velocity=tuple(map(tuple, velocity.tolist())),
        acceleration=tuple(map(tuple, acceleration.tolist())),
    )
    states = ros_joint_states(trajectory, dt)
    path = TimedTrajectory.of(trajectory, JOINTS)
    assert trajectory.duration <= (len(states) - 1) * dt + 1e-9 < trajectory.duration + dt + 1e-8
    for k, state in enumerate(states):
        there = path.at(k * dt)
        assert tuple(state.name) == JOINTS
        np.testing.assert_allclose(state.position, there[0], atol=1e-9)
        np.testing.assert_allclose(state.velocity, there[1], atol=1e-7)
    np.testing.assert_allclose(states[-1].position, position[-1], atol=1e-9)
    np.testing.assert_allclose(states[-1].velocity, 0.0, atol=1e-7)


# -- the scene --

sizes = st.floats(1e-3, 10.0)
Object = AddObject.Request


@promised(vectors, turns, st.tuples(sizes, sizes, sizes))
def test_an_object_has_its_pose_and_the_sizes_of_its_kind(
    position: tuple[float, float, float], turn: tuple[float, float, float, float], d: tuple[float, float, float]
) -> None:
    def added(kind: int) -> Any:
        return object_of(
            Object(
                type=kind,
                name="thing",
                mesh_file_path="a/b.stl",
                pose=placed(position, turn),
                dimensions=Vector3(x=d[0], y=d[1], z=d[2]),
            )
        )

    at = {"name": "thing", "position": position, "orientation": Pose(position=position, orientation=turn).orientation}
    assert added(Object.CUBOID) == Cuboid(kind="cuboid", size=d, **at)
    assert added(Object.SPHERE) == Sphere(kind="sphere", name="thing", position=position, radius=d[0])
    assert added(Object.CAPSULE) == Capsule(kind="capsule", radius=d[0], length=d[2], **at)
    assert added(Object.CYLINDER) == Cylinder(kind="cylinder", radius=d[0], length=d[2], **at)
    assert added(Object.MESH) == Mesh(kind="mesh", file="a/b.stl", scale=d, **at)


def test_sizes_that_a_kind_does_not_have_may_be_anything() -> None:
    nothing = Vector3(x=0.1, y=math.nan, z=math.nan)
    assert object_of(Object(type=Object.SPHERE, name="ball", dimensions=nothing)).radius == 0.1
    nothing.z = 0.2
    assert object_of(Object(type=Object.CYLINDER, name="can", dimensions=nothing)).length == 0.2
    assert object_of(Object(type=Object.MESH, name="mesh", mesh_file_path="m.stl")).scale == (1.0, 1.0, 1.0)


@pytest.mark.parametrize(
    ("fields", "field"),
    [
        ({"type": 5}, "type"),
        ({"type": -1}, "type"),
        ({"name": ""}, "name"),
        ({"name": "a/b"}, "name"),
        ({"name": "x" * 65}, "name"),
        ({"dimensions": Vector3(x=1.0, y=0.0, z=1.0)}, "dimensions.y"),
        ({"dimensions": Vector3(x=-1.0, y=1.0, z=1.0)}, "dimensions.x"),
        ({"dimensions": Vector3(x=1.0, y=1.0, z=math.nan)}, "dimensions.z"),
        ({"type": Object.SPHERE, "dimensions": Vector3(x=0.0)}, "dimensions.x"),
        ({"type": Object.CAPSULE, "dimensions": Vector3(x=0.1)}, "dimensions.z"),
        ({"type": Object.MESH}, "mesh_file_path"),
        ({"pose": placed((0.0, math.nan, 0.0))}, "pose.position.y"),
    ],
)
def test_an_object_that_cannot_be_is_named(fields: dict[str, Any], field: str) -> None:
    good = {"type": Object.CUBOID, "name": "box", "dimensions": Vector3(x=1.0, y=1.0, z=1.0)}
    assert fault(object_of, Object(**(good | fields))) == field


def test_a_colour_is_kept_only_where_it_is_one() -> None:
    assert colour_of(Object(color=ColorRGBA(r=1.0, g=0.5, b=0.0, a=1.0))) == (1.0, 0.5, 0.0, 1.0)
    assert colour_of(Object(color=ColorRGBA())) is None
    assert colour_of(Object(color=ColorRGBA(r=255.0, a=1.0))) is None


def grid_of(cells: list[tuple[int, int, int]], resolution: float, *box: tuple[float, float, float]) -> Any:
    grid = SimpleNamespace(header=SimpleNamespace(), origin=SimpleNamespace())
    occupancy = Occupancy(scene_revision="1-5be0c1d2f3a4", resolution=resolution, cells=tuple(cells))
    fill_grid(grid, occupancy, "base_link", box or None)
    return grid


def occupied(grid: Any) -> np.ndarray:
    """Centres (n, 3) of the occupied voxels of a grid."""
    cells = np.argwhere(np.reshape(grid.data, (grid.size_x, grid.size_y, grid.size_z)))
    return (cells + 0.5) * grid.resolutions.x + (grid.origin.x, grid.origin.y, grid.origin.z)


@promised(st.sets(st.tuples(*[st.integers(-20, 20)] * 3), max_size=50), st.sampled_from([0.002, 0.05, 1.0]))
def test_a_grid_has_the_voxels_at_their_places(cells: set[tuple[int, int, int]], resolution: float) -> None:
    grid = grid_of(list(cells), resolution)
    assert grid.header.frame_id == "base_link"
    assert len(occupied(grid)) == len(cells)
    np.testing.assert_allclose(occupied(grid), np.array(sorted(cells)).reshape(-1, 3) * resolution, atol=1e-9)


def test_a_box_has_the_voxels_inside_and_must_not_be_too_large() -> None:
    grid = grid_of([(0, 0, 0), (3, 0, 0), (9, 0, 0)], 0.1, (-0.2, -0.2, -0.2), (0.4, 0.2, 0.2))
    np.testing.assert_allclose(occupied(grid), [(0.0, 0.0, 0.0), (0.3, 0.0, 0.0)], atol=1e-9)
    assert fault(grid_of, [], 0.005, (-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)) == "voxel_size"
