"""Lines, arcs and paths: the tip keeps to the curve, and the joints to their limits, between the samples too."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest

from support.planner.second_opinion import link_pose
from zarm_contract.errors import InvalidRequest, PlanningFailed
from zarm_contract.messages import (
    ArcGoal,
    CartesianGoal,
    Cuboid,
    LineGoal,
    PathGoal,
    PathPoint,
    SceneObject,
    TipFrame,
)
from zarm_contract.robot import load_robot
from zarm_geometry.exact import ExactScene
from zarm_geometry.frames import matrix, pose_of
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.cartesian.curve import tool_curve
from zarm_planner.context import PlanningContext
from zarm_planner.deadline import Deadline
from zarm_planner.pipeline import Verified, plan
from zarm_planner.planners.registry import choose
from zarm_planner.scene.planning_scene import PlanningScene
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits

MODELS = {name: RobotModel.of(load_robot(name)) for name in ("doosan_m1013", "ur5e", "panda")}
M1013 = MODELS["doosan_m1013"]
HOME = np.array(M1013.robot.descriptor.home)
DISTANCE, ANGLE = 1e-4, math.radians(0.1)
TOLERANCE = 1.002
"""Factor by which a limit may be exceeded: rounding."""


def planned(model: RobotModel, goal: CartesianGoal, *objects: SceneObject, start: Array | None = None) -> Verified:
    world = World(objects, 0.005)
    scene = PlanningScene("1-000000000000", model, world, ExactScene(model, world))
    context = PlanningContext(scene, Limits.of(model.robot), Deadline(60.0), optimize_s=0.0)
    q = np.array(model.robot.descriptor.home) if start is None else start
    return plan(choose("auto", goal, False), context, q, goal)


def tip(model: RobotModel, q: Array | None = None) -> Array:
    return model.fk_tip(np.array(model.robot.descriptor.home) if q is None else q)


def dense(verified: Verified, step: float = 5e-4) -> tuple[Array, Array]:
    """Times (n,) in s, many between two samples, and the joints (n, dof) there."""
    trajectory = verified.trajectory
    times = np.linspace(0.0, trajectory.duration, int(trajectory.duration / step) + 2)
    return times, trajectory.positions(times)


def turned_by(a: Array, b: Array) -> float:
    """The angle (rad) between two orientations (3, 3)."""
    return 2.0 * math.asin(min(1.0, float(np.linalg.norm(a - b)) / math.sqrt(8.0)))


def keeps_limits(model: RobotModel, verified: Verified) -> None:
    """Velocity, acceleration and jerk of the returned quintics, by finite differences far finer than the samples."""
    trajectory, limits = verified.trajectory, Limits.of(model.robot)
    step = 1e-4
    times = np.linspace(0.0, trajectory.duration, int(trajectory.duration / step) + 2)
    _, velocity, acceleration = trajectory.sample(times)
    jerk = np.diff(acceleration, axis=0) / np.diff(times)[:, None]
    assert np.all(np.abs(velocity) <= limits.velocity * TOLERANCE)
    assert np.all(np.abs(acceleration) <= limits.acceleration * TOLERANCE)
    assert np.all(np.abs(jerk) <= limits.jerk * TOLERANCE * 1.01)
    assert np.all(trajectory.positions(times) >= model.lower - 1e-4)
    assert np.all(trajectory.positions(times) <= model.upper + 1e-4)


def on_line(a: Array, b: Array, point: Array) -> float:
    """The distance (m) of a point from the segment between two."""
    along = b - a
    share = min(max(float((point - a) @ along) / float(along @ along), 0.0), 1.0)
    return float(np.linalg.norm(a + share * along - point))


def shifted(pose: Array, *shift: float) -> tuple[float, float, float]:
    x, y, z = (pose[:3, 3] + shift).tolist()
    return x, y, z


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("shift", [(0.0, 0.25, 0.0), (0.0, 0.0, -0.2), (-0.05, -0.1, 0.05)])
def test_line_is_straight_and_keeps_the_orientation(name: str, shift: tuple[float, float, float]) -> None:
    model = MODELS[name]
    begin = tip(model)
    target = np.array(shifted(begin, *shift))
    verified = planned(model, LineGoal(kind="line", position=shifted(begin, *shift)))
    _, joints = dense(verified)
    for q in joints[:: max(1, len(joints) // 400)]:
        pose = link_pose(model.robot, model.robot.descriptor.tip_link, q)
        assert on_line(begin[:3, 3], target, pose[:3, 3]) <= DISTANCE
        assert turned_by(begin[:3, :3], pose[:3, :3]) <= ANGLE
    assert tip(model, joints[-1])[:3, 3] == pytest.approx(target, abs=1e-5)
    keeps_limits(model, verified)


def test_orientation_turns_evenly_with_the_way() -> None:
    begin = tip(M1013)
    end = begin @ matrix((0.0, 0.0, 0.0), (0.0, math.sin(0.25), 0.0, math.cos(0.25)))
    end[:3, 3] += (0.0, 0.2, 0.0)
    at = pose_of(end)
    verified = planned(M1013, LineGoal(kind="line", position=at.position, orientation=at.orientation))
    _, joints = dense(verified, 0.01)
    for q in joints:
        pose = tip(M1013, q)
        share = float(pose[1, 3] - begin[1, 3]) / 0.2
        assert turned_by(begin[:3, :3], pose[:3, :3]) == pytest.approx(0.5 * share, abs=2 * ANGLE)


def test_tool_keeps_the_speed_that_is_asked_for() -> None:
    begin = tip(M1013)
    verified = planned(
        M1013, LineGoal(kind="line", position=shifted(begin, 0.0, 0.4, 0.0), speed=0.1, acceleration=0.5)
    )
    times, joints = dense(verified)
    moved = np.linalg.norm(np.diff(tip(M1013, joints)[:, :3, 3], axis=0), axis=1) / np.diff(times)
    assert moved.max() <= 0.1 * TOLERANCE
    assert np.mean(moved > 0.099) > 0.8
    assert verified.tool is not None
    assert verified.tool.speed_share > 0.85
    assert verified.tool.length == pytest.approx(0.4, abs=1e-6)
    assert np.abs(np.diff(moved) / np.diff(times[1:])).max() <= 0.5 * 1.05


def test_tool_turns_no_faster_than_its_rotational_speed() -> None:
    begin = tip(M1013)
    end = begin @ matrix((0.0, 0.0, 0.0), (0.0, 0.0, math.sin(0.5), math.cos(0.5)))
    at = pose_of(end)
    verified = planned(
        M1013, LineGoal(kind="line", position=at.position, orientation=at.orientation, rotational_speed=0.3)
    )
    times, joints = dense(verified)
    poses = tip(M1013, joints)
    rates = [turned_by(a, b) for a, b in itertools.pairwise(poses[:, :3, :3])] / np.diff(times)
    assert rates.max() <= 0.3 * 1.01
    assert np.abs(poses[:, :3, 3] - begin[:3, 3]).max() <= DISTANCE


@pytest.mark.parametrize("given", ["via", "center"])
@pytest.mark.parametrize("orienting", ["interpolated", "tangent"])
def test_arc_keeps_to_its_circle(given: str, orienting: Any) -> None:
    begin = tip(M1013)
    center = begin[:3, 3] + (0.0, 0.15, 0.0)

    def on_circle(phi: float) -> Array:
        return center + 0.15 * np.array((math.sin(phi), -math.cos(phi), 0.0))

    end = tuple(on_circle(-2.0).tolist())
    aid = {"via": tuple(on_circle(-1.0).tolist())} if given == "via" else {"center": tuple(center.tolist())}
    verified = planned(M1013, ArcGoal(kind="arc", position=end, orienting=orienting, **aid))
    _, joints = dense(verified, 0.005)
    for pose in tip(M1013, joints):
        off = pose[:3, 3] - center
        assert abs(np.linalg.norm(off) - 0.15) <= DISTANCE
        assert abs(off[2]) <= DISTANCE
        phi = math.atan2(off[0], -off[1]) if orienting == "tangent" else 0.0
        wanted = matrix((0.0, 0.0, 0.0), (0.0, 0.0, math.sin(phi / 2), math.cos(phi / 2))) @ begin
        assert turned_by(wanted[:3, :3], pose[:3, :3]) <= ANGLE + 1e-3 * abs(phi)
    assert tip(M1013, joints[-1])[:3, 3] == pytest.approx(end, abs=1e-5)
    keeps_limits(M1013, verified)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_full_circle_begins_towards_via(side: float) -> None:
    begin = tip(M1013)
    start, radius = begin[:3, 3], 0.1
    center = start + (0.0, radius, 0.0)
    via = center + radius * np.array((0.0, math.sin(0.3), side * math.cos(0.3)))
    goal = ArcGoal(kind="arc", position=tuple(start), center=tuple(center), via=tuple(via))
    verified = planned(M1013, goal)
    _, joints = dense(verified, 0.005)
    off = tip(M1013, joints)[:, :3, 3] - center
    assert np.abs(np.linalg.norm(off, axis=1) - radius).max() <= DISTANCE
    angles = np.unwrap(np.arctan2(side * off[:, 2], -off[:, 1]))
    assert np.all(np.diff(angles) >= -1e-6)
    assert angles[-1] - angles[0] == pytest.approx(2.0 * math.pi, abs=1e-3)
    keeps_limits(M1013, verified)


@pytest.mark.parametrize("orienting", ["interpolated", "tangent"])
def test_path_of_lines_and_arcs_keeps_to_them(orienting: Any) -> None:
    begin = tip(M1013)
    a = begin[:3, 3]
    b, c, d, center = (a + shift for shift in ((0, 0.15, 0), (0, 0.25, -0.1), (0, 0.25, -0.2), (0, 0.15, -0.1)))
    points = (
        PathPoint(position=tuple(b)),
        PathPoint(position=tuple(c), center=tuple(center)),
        PathPoint(position=tuple(d)),
    )
    verified = planned(M1013, PathGoal(kind="path", points=points, blend=0.01, orienting=orienting))
    _, joints = dense(verified, 0.005)
    for pose in tip(M1013, joints):
        x, y, z = pose[:3, 3] - a
        on_arc = y > 0.15 and z > -0.1
        off = abs(math.hypot(y - 0.15, z + 0.1) - 0.1) if on_arc else abs(z) if z > -0.1 else abs(y - 0.25)
        at_corner = min(np.linalg.norm(pose[:3, 3] - corner) for corner in (b, c)) < 0.0105
        assert abs(x) <= DISTANCE
        assert off <= (0.001 if at_corner else DISTANCE)
    turned = turned_by(begin[:3, :3], tip(M1013, joints[-1])[:3, :3])
    assert turned == pytest.approx(math.pi / 2 if orienting == "tangent" else 0.0, abs=1e-3)
    keeps_limits(M1013, verified)


@pytest.mark.parametrize("blend", [None, 0.02, 0.0])
def test_path_leaves_its_lines_only_in_the_corners(blend: float | None) -> None:
    begin = tip(M1013)
    corners = [begin[:3, 3] + shift for shift in ((0, 0, 0), (0, 0.2, 0), (0.0, 0.2, -0.15), (0.0, 0.0, -0.15))]
    points = tuple(PathPoint(position=tuple(corner.tolist())) for corner in corners[1:])
    verified = planned(M1013, PathGoal(kind="path", points=points, blend=blend))
    times, joints = dense(verified, 0.002)
    poses = tip(M1013, joints)
    width = 0.01 if blend is None else blend
    for pose in poses:
        aside = min(on_line(a, b, pose[:3, 3]) for a, b in itertools.pairwise(corners))
        nearest_corner = min(float(np.linalg.norm(pose[:3, 3] - corner)) for corner in corners[1:-1])
        assert aside <= (width if nearest_corner <= width + 1e-3 else 0.0) + DISTANCE
        assert np.all(pose[:3, 3] >= np.min(corners, axis=0) - DISTANCE)  # corners are cut, not passed outside
        assert np.all(pose[:3, 3] <= np.max(corners, axis=0) + DISTANCE)
        assert turned_by(begin[:3, :3], pose[:3, :3]) <= ANGLE
    speed = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1) / np.diff(times)
    at_corner = [int(np.argmin(np.linalg.norm(poses[:-1, :3, 3] - corner, axis=1))) for corner in corners[1:-1]]
    if blend == 0.0:
        assert speed[at_corner].max() < 0.01
    else:
        assert speed[at_corner].min() > 0.01
    keeps_limits(M1013, verified)


def test_corner_turns_without_a_kink() -> None:
    """The direction of the curve changes gradually: half as much over half as far."""
    points = points_of((0.0, 0.2, 0.0), (0.0, 0.2, -0.15))
    curve = tool_curve(PathGoal(kind="path", points=points, blend=0.02), BEGIN, (0.25, 1.0, 1.0), "goal")
    largest = []
    for count in (4000, 8000):
        position = curve.at(np.linspace(0.0, float(curve.stations[-1]), count + 1))[0]
        along = np.diff(position, axis=0)
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        largest.append(float(np.linalg.norm(np.diff(along, axis=0), axis=1).max()))
    assert largest[1] == pytest.approx(largest[0] / 2, rel=0.05)


def test_spline_passes_its_points_smoothly() -> None:
    begin = tip(M1013)
    points = [begin[:3, 3] + (0.03 * math.sin(k), 0.05 * k, -0.02 * k) for k in range(1, 6)]
    goal = PathGoal(
        kind="path", points=tuple(PathPoint(position=tuple(point.tolist())) for point in points), shape="spline"
    )
    verified = planned(M1013, goal)
    _, joints = dense(verified, 0.002)
    poses = tip(M1013, joints)
    for point in points:
        assert np.linalg.norm(poses[:, :3, 3] - point, axis=1).min() < 5e-4
    keeps_limits(M1013, verified)


@pytest.mark.parametrize("name", MODELS)
def test_seam_around_a_post_with_a_free_turn_about_the_tool(name: str) -> None:
    model = MODELS[name]
    begin = tip(model)
    center = begin[:3, 3] + (0.06, 0.0, 0.0)
    points = []
    for k in range(1, 101):
        phi = 2.0 * math.pi * k / 100.0
        at = center - 0.06 * np.array((math.cos(phi), math.sin(phi), 0.0))
        points.append(PathPoint(position=tuple(at.tolist())))
    goal = PathGoal(kind="path", points=tuple(points), speed=0.05, orientation_tolerance=(0.0, 0.0, "free"))
    verified = planned(model, goal)
    _, joints = dense(verified, 0.01)
    for pose in tip(model, joints):
        off = pose[:3, 3] - center
        assert abs(np.linalg.norm(off) - 0.06) <= 2e-4  # the chords of 100 points are 0.03 mm inside the circle
        assert abs(off[2]) <= DISTANCE
        assert float(pose[:3, 2] @ begin[:3, 2]) >= math.cos(ANGLE)
    assert np.abs(np.diff(joints, axis=0)).max() < 0.05
    keeps_limits(model, verified)


def test_freedom_follows_a_line_that_a_fixed_tool_cannot() -> None:
    begin = tip(M1013)
    target = shifted(begin, 0.45, 0.0, 0.0)
    with pytest.raises(PlanningFailed):
        planned(M1013, LineGoal(kind="line", position=target))
    free = planned(M1013, LineGoal(kind="line", position=target, orientation_tolerance=("free", "free", "free")))
    assert tip(M1013, free.trajectory.end)[:3, 3] == pytest.approx(target, abs=1e-5)


def test_another_frame_may_follow_the_line() -> None:
    flange = TipFrame(link="link_5")
    begin = link_pose(M1013.robot, "link_5", HOME)
    target = shifted(begin, 0.0, 0.1, 0.0)
    goal = LineGoal(kind="line", position=target, tip=flange, orientation_tolerance=("free", "free", "free"))
    verified = planned(M1013, goal)
    _, joints = dense(verified, 0.01)
    for q in joints:
        assert on_line(begin[:3, 3], np.array(target), link_pose(M1013.robot, "link_5", q)[:3, 3]) <= DISTANCE


def test_line_out_of_reach_says_how_far_it_comes_and_why() -> None:
    begin = tip(M1013)
    with pytest.raises(PlanningFailed, match=r"for \d+\.\d % of its way: near .* m ") as failed:
        planned(M1013, LineGoal(kind="line", position=shifted(begin, 3.0, 0.0, 0.0)))
    assert failed.value.problem.fraction is not None
    assert 0.0 < failed.value.problem.fraction < 0.5


def test_line_through_an_obstacle_names_it_and_how_far_it_comes() -> None:
    begin = tip(M1013)
    middle = shifted(begin, 0.0, 0.3, 0.0)
    wall = Cuboid(kind="cuboid", name="wall", position=middle, size=(0.1, 0.02, 0.1))
    with pytest.raises(PlanningFailed, match="wall") as failed:
        planned(M1013, LineGoal(kind="line", position=shifted(begin, 0.0, 0.5, 0.0)), wall)
    assert failed.value.problem.fraction is not None
    assert 0.0 < failed.value.problem.fraction < 0.6


def points_of(*shifts: tuple[float, float, float]) -> tuple[PathPoint, ...]:
    return tuple(PathPoint(position=shifted(tip(M1013), *shift)) for shift in shifts)


BEGIN = tip(M1013)


@pytest.mark.parametrize(
    ("goal", "field", "said"),
    [
        (LineGoal(kind="line", position=shifted(BEGIN, 0, 0, 0)), "goal.position", "no extent"),
        (
            ArcGoal(kind="arc", position=shifted(BEGIN, 0, 0.2, 0), via=shifted(BEGIN, 0, 0.1, 0)),
            "goal.via",
            "lie on a line",
        ),
        (
            ArcGoal(kind="arc", position=shifted(BEGIN, 0, 0.2, 0), center=shifted(BEGIN, 0, 0.05, 0)),
            "goal.center",
            "as far from both",
        ),
        (
            ArcGoal(kind="arc", position=shifted(BEGIN, 0, 0.2, 0), center=shifted(BEGIN, 0, 0.1, 0)),
            "goal.center",
            "give via",
        ),
        (ArcGoal(kind="arc", position=shifted(BEGIN, 0, 0.2, 0)), "goal.via", "either via"),
        (
            ArcGoal(kind="arc", position=shifted(BEGIN, 0, 0, 0), via=shifted(BEGIN, 0, 0.1, 0)),
            "goal.center",
            "give both",
        ),
        (
            ArcGoal(
                kind="arc",
                position=shifted(BEGIN, 0, 0, 0),
                via=shifted(BEGIN, 0, 0.2, 0),
                center=shifted(BEGIN, 0, 0.1, 0),
            ),
            "goal.via",
            "move via",
        ),
        (
            PathGoal(
                kind="path",
                shape="spline",
                points=(PathPoint(position=shifted(BEGIN, 0, 0.2, 0), via=shifted(BEGIN, 0, 0.1, 0.1)),),
            ),
            "goal.points.0",
            "a spline has no arcs",
        ),
        (
            PathGoal(kind="path", points=points_of((0, 0.1, 0), (0, 0.1, 0))),
            "goal.points.1",
            "is the one before",
        ),
        (
            PathGoal(kind="path", points=points_of((0, 0.1, 0), (0, 0.1, 0.1)), blend=0.2),
            "goal.blend",
            "does not fit",
        ),
        (
            PathGoal(kind="path", points=points_of((0, 0.1, 0), (0, 0.02, 0))),
            "goal.points.0",
            "doubles back",
        ),
        (
            PathGoal(kind="path", points=points_of((0, 0.1, 0), (0, 0.1, 0.1)), blend=0.0, orienting="tangent"),
            "goal.blend",
            "on the spot",
        ),
        (LineGoal(kind="line", position=shifted(BEGIN, 0.1, 0, 0), tip=TipFrame(link="hand")), "goal.tip.link", "hand"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_curve_that_makes_no_sense_is_refused_by_field(goal: CartesianGoal, field: str, said: str) -> None:
    with pytest.raises(InvalidRequest, match=said) as refused:
        planned(M1013, goal)
    assert refused.value.problem.field == field


def test_line_takes_no_path_constraint() -> None:
    goal = LineGoal(kind="line", position=shifted(BEGIN, 0.1, 0, 0))
    with pytest.raises(InvalidRequest, match="line with a path constraint"):
        choose("auto", goal, True)
