"""Programs: segments planned one after the other, each so that those after it can be followed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from support.planner.second_opinion import link_pose
from zarm_contract.errors import InvalidRequest, PlanningFailed
from zarm_contract.messages import (
    AddObjects,
    ArcGoal,
    Attach,
    AttachObject,
    Cuboid,
    Detach,
    DetachObject,
    GoalState,
    JointGoal,
    LineGoal,
    Move,
    Offset,
    Plan,
    PlanRequest,
    PoseGoal,
    PoseTolerance,
    ProgramRequest,
    SceneEdit,
    SceneEdited,
    Segment,
    SpeedChange,
    Wait,
    WaypointsGoal,
)
from zarm_contract.robot import load_robot
from zarm_executor.checks import executable
from zarm_geometry.frames import pose_of
from zarm_geometry.meshes import Meshes
from zarm_geometry.robot_model import RobotModel
from zarm_planner.handlers import Handlers
from zarm_planner.program_changes import ProgramChanges
from zarm_planner.programs import ChangeAt
from zarm_planner.scene.store import SceneStore

ROBOT = load_robot("doosan_m1013")
MODEL = RobotModel.of(ROBOT)
HOME = ROBOT.descriptor.home
TIP = MODEL.fk_tip(np.array(HOME))
DOWN = PoseTolerance(orientation=(0.0, 0.0, "free"))


@pytest.fixture
def handlers(tmp_path) -> Handlers:  # type: ignore[no-untyped-def]
    store = SceneStore(tmp_path, Meshes(()), ROBOT.urdf.links)
    return Handlers(MODEL, "arm", store, lambda: np.array(HOME))


def at(*shift: float) -> tuple[float, float, float]:
    x, y, z = (TIP[:3, 3] + shift).tolist()
    return x, y, z


def pose_goal(*shift: float, **fields: object) -> PoseGoal:
    return PoseGoal(kind="pose", position=at(*shift), orientation=pose_of(TIP).orientation, **fields)  # type: ignore[arg-type]


def line(*shift: float) -> LineGoal:
    return LineGoal(kind="line", position=at(*shift))


def move(goal: object, name: str | None = None) -> Move:
    return Move(kind="move", goal=goal, name=name)  # type: ignore[arg-type]


def planned(handlers: Handlers, *segments: Segment) -> tuple[Plan, tuple[ChangeAt, ...]]:
    return handlers.program(ProgramRequest(segments=segments))


def joints_at(plan: Plan, time: float) -> tuple[float, ...]:
    trajectory = executable(plan.trajectory, ROBOT)
    return tuple(trajectory.positions(np.array((time,)))[0].tolist())


def tip_at(plan: Plan, time: float) -> np.ndarray:
    return link_pose(ROBOT, ROBOT.descriptor.tip_link, joints_at(plan, time))


def test_segments_follow_each_other_in_one_motion(handlers: Handlers) -> None:
    plan, changes = planned(
        handlers,
        move(pose_goal(0.0, 0.3, 0.0), "there"),
        move(line(0.0, 0.3, -0.2)),
        Wait(kind="wait", duration=1.5),
        SpeedChange(kind="speed", velocity_scale=0.3),
        move(JointGoal(kind="joints", position=HOME), "back"),
    )
    assert changes == ()
    assert [segment.action for segment in plan.segments] == ["move", "move", "wait", "speed", "move"]
    assert [segment.begin for segment in plan.segments[1:]] == [segment.end for segment in plan.segments[:-1]]
    assert plan.segments[-1].end == pytest.approx(plan.trajectory.duration)
    assert plan.segments[2].end - plan.segments[2].begin == pytest.approx(1.5)
    assert tip_at(plan, plan.segments[0].end)[:3, 3] == pytest.approx(at(0.0, 0.3, 0.0), abs=1e-5)
    assert tip_at(plan, plan.segments[1].end)[:3, 3] == pytest.approx(at(0.0, 0.3, -0.2), abs=1e-5)
    assert joints_at(plan, plan.trajectory.duration) == pytest.approx(HOME, abs=1e-5)
    assert plan.segments[0].name == "there"


def test_speed_change_slows_what_comes_after_it(handlers: Handlers) -> None:
    there, back = JointGoal(kind="joints", position=(0.8, *HOME[1:])), JointGoal(kind="joints", position=HOME)
    slow = SpeedChange(kind="speed", velocity_scale=0.2, acceleration_scale=0.5)
    plan, _ = planned(handlers, move(there), slow, move(back))
    first, _, last = (segment.end - segment.begin for segment in plan.segments)
    assert last > 2 * first


@pytest.mark.parametrize(
    ("begin", "end"),
    [
        ((-0.06, 0.41, 0.17), (0.15, 0.23, 0.38)),
        ((-0.09, 0.29, 0.06), (0.05, 0.42, 0.35)),
        ((0.14, 0.11, -0.13), (0.41, 0.26, 0.04)),
    ],
)
def test_the_branch_is_chosen_so_that_the_line_can_be_followed(
    handlers: Handlers, begin: tuple[float, float, float], end: tuple[float, float, float]
) -> None:
    """The configuration that is reached soonest cannot follow the line to its end, and another one can."""
    first = move(pose_goal(*begin, tolerance=PoseTolerance(orientation=("free", "free", "free"))))
    alone = planned(handlers, first)[0].trajectory.position[-1]
    with pytest.raises(PlanningFailed):
        handlers.plan(PlanRequest(start=tuple(map(float, alone)), goal=line(*end)))
    plan, _ = planned(handlers, first, move(line(*end)))
    time = plan.segments[0].end
    assert tip_at(plan, time)[:3, 3] == pytest.approx(at(*begin), abs=1e-5)
    assert tip_at(plan, plan.trajectory.duration)[:3, 3] == pytest.approx(at(*end), abs=1e-5)


def test_approach_and_retreat_are_straight(handlers: Handlers) -> None:
    ways = {
        "approach": Offset(distance=0.1, direction=(0.0, 0.0, 1.0)),
        "retreat": Offset(distance=0.15, direction=(0.0, 0.0, 2.0), frame="base"),
    }
    plan = handlers.plan(PlanRequest(start=HOME, goal=pose_goal(0.1, 0.3, -0.2, tolerance=DOWN, **ways)))
    trajectory = executable(plan.trajectory, ROBOT)
    times = np.linspace(0.0, trajectory.duration, 3000)
    tips = MODEL.fk_tip(trajectory.positions(times))
    pose = at(0.1, 0.3, -0.2)
    reached = int(np.argmin(np.linalg.norm(tips[:, :3, 3] - pose, axis=1)))
    assert tips[reached, :3, 3] == pytest.approx(pose, abs=1e-4)
    axis = TIP[:3, 2]
    near = [tip[:3, 3] - pose for tip in tips[:reached] if np.linalg.norm(tip[:3, 3] - pose) < 0.095]
    assert near
    for off in near:
        assert np.linalg.norm(off - (off @ axis) * axis) < 2e-4
        assert off @ axis < 1e-4
    assert tips[-1, :3, 3] == pytest.approx(np.array(pose) + (0.0, 0.0, 0.15), abs=1e-5)
    for tip in tips[reached:]:
        assert tip[:2, 3] == pytest.approx(pose[:2], abs=2e-4)


def test_lines_blend_into_each_other_without_stopping(handlers: Handlers) -> None:
    corner = move(line(0.0, 0.2, 0.0), "over").model_copy(update={"blend": 0.03})
    plan, _ = planned(handlers, corner, move(line(0.0, 0.2, -0.15)), Wait(kind="wait", duration=0.5))
    assert [segment.name for segment in plan.segments[:1]] == ["over"]
    passed = plan.segments[0].end
    assert plan.segments[1].begin == passed
    assert plan.segments[1].end < plan.segments[2].end
    off = np.linalg.norm(tip_at(plan, passed)[:3, 3] - at(0.0, 0.2, 0.0))
    assert 0.003 < off < 0.03
    step = 0.01
    speed = np.linalg.norm(tip_at(plan, passed + step)[:3, 3] - tip_at(plan, passed)[:3, 3]) / step
    assert speed > 0.02
    assert tip_at(plan, plan.segments[1].end)[:3, 3] == pytest.approx(at(0.0, 0.2, -0.15), abs=1e-5)


def blending(goal: object, blend: float, name: str | None = None) -> Move:
    return move(goal, name).model_copy(update={"blend": blend})


def speeds_of_tip(plan: Plan, begin: float, end: float) -> np.ndarray:
    """How fast (m/s) the tip is every 10 ms between two times."""
    times = np.arange(begin, end, 0.01)
    tips = np.array([tip_at(plan, time)[:3, 3] for time in times])
    return np.asarray(np.linalg.norm(np.diff(tips, axis=0), axis=1) / 0.01)


def test_line_blends_into_an_arc_and_an_arc_into_a_line(handlers: Handlers) -> None:
    arc = ArcGoal(kind="arc", position=at(0.0, 0.1, -0.2), via=at(0.0, 0.2, -0.1))
    plan, _ = planned(
        handlers,
        blending(line(0.0, 0.1, 0.0), 0.02, "seam"),
        blending(arc, 0.02, "bend"),
        move(line(0.0, -0.1, -0.2), "back"),
    )
    assert [segment.name for segment in plan.segments] == ["seam", "bend", "back"]
    assert speeds_of_tip(plan, 0.3, plan.trajectory.duration - 0.3).min() > 0.02
    middle = (plan.segments[1].begin + plan.segments[1].end) / 2
    assert np.linalg.norm(tip_at(plan, middle)[:3, 3] - at(0.0, 0.1, -0.1)) == pytest.approx(0.1, abs=2e-4)
    assert tip_at(plan, plan.trajectory.duration)[:3, 3] == pytest.approx(at(0.0, -0.1, -0.2), abs=1e-5)


def test_free_motions_blend_past_the_goals_between_them(handlers: Handlers) -> None:
    over = JointGoal(kind="joints", position=(0.5, *HOME[1:]))
    plan, _ = planned(
        handlers,
        blending(over, 0.05, "over"),
        blending(pose_goal(0.0, 0.3, -0.2), 0.05, "past"),
        move(pose_goal(0.0, 0.0, -0.2), "there"),
    )
    assert [segment.name for segment in plan.segments] == ["over", "past", "there"]
    assert speeds_of_tip(plan, 0.5, plan.trajectory.duration - 0.5).min() > 0.02
    passed = tip_at(plan, plan.segments[1].end)[:3, 3]
    assert np.linalg.norm(passed - at(0.0, 0.3, -0.2)) <= 0.05
    assert tip_at(plan, plan.trajectory.duration)[:3, 3] == pytest.approx(at(0.0, 0.0, -0.2), abs=1e-5)


def test_smallest_blend_of_free_motions_is_planned(handlers: Handlers) -> None:
    over = JointGoal(kind="joints", position=(0.3, *HOME[1:]))
    plan, _ = planned(handlers, blending(over, 1e-4), move(JointGoal(kind="joints", position=HOME)))
    assert joints_at(plan, plan.segments[0].end)[0] == pytest.approx(0.3, abs=1e-3)


def test_error_in_a_blend_names_its_own_segment(handlers: Handlers) -> None:
    straight = ArcGoal(kind="arc", position=at(0.0, 0.3, 0.0), via=at(0.0, 0.2, 0.0))
    with pytest.raises(InvalidRequest, match="segment 1, bend: the start, via and position lie on a line") as refused:
        planned(handlers, blending(line(0.0, 0.1, 0.0), 0.02), move(straight, "bend"))
    assert refused.value.problem.field == "segments.1.goal.via"


def put(handlers: Handlers, *objects: Cuboid) -> None:
    handlers.edit(SceneEdit(edit=AddObjects(op="add", objects=objects)))


def test_an_attached_object_moves_along_and_stays_where_detached(handlers: Handlers) -> None:
    part = Cuboid(kind="cuboid", name="part", position=at(0.0, 0.2, -0.3), size=(0.04, 0.04, 0.2))
    put(handlers, part)
    before = pose_goal(0.0, 0.2, -0.18)
    plan, changes = planned(
        handlers,
        move(before, "above"),
        Attach(kind="attach", object="part", touch_links=("link_6",)),
        move(line(0.0, 0.2, 0.0)),
        move(pose_goal(0.0, -0.2, 0.0)),
        Detach(kind="detach", object="part"),
    )
    (grasp, attached), (drop, detached) = changes
    assert attached.name == detached.name == "part"
    assert joints_at(plan, grasp) == pytest.approx(attached.joints, abs=1e-5)
    assert drop == pytest.approx(plan.segments[4].begin)
    for _, change in changes:
        scene = handlers.edit(SceneEdit(edit=change))
    (left,) = scene.objects
    assert left.position == pytest.approx(at(0.0, -0.2, -0.12), abs=1e-3)


def test_answer_to_an_approach_says_which_pose_was_chosen(handlers: Handlers) -> None:
    ways = {side: Offset(distance=0.05, direction=(0.0, 0.0, 1.0), frame="base") for side in ("approach", "retreat")}
    loose = PoseTolerance(orientation=(0.0, 0.0, "free"), position=(0.01, 0.01, 0.0))
    plan = handlers.plan(PlanRequest(start=HOME, goal=pose_goal(0.0, 0.3, 0.0, tolerance=loose, **ways)))
    assert plan.goal_deviation is not None
    assert all(abs(off) <= 0.01 for off in plan.goal_deviation[3:])
    with pytest.raises(InvalidRequest, match="no planner fancy"):
        handlers.plan(PlanRequest(start=HOME, planner="fancy", goal=pose_goal(0.0, 0.3, 0.0, **ways)))


def test_last_state_of_a_goal_that_arrives_again_changes_nothing() -> None:
    made: list[str] = []

    def edit(asked: SceneEdit) -> SceneEdited:
        made.append(asked.edit.op)
        return SceneEdited(revision="1-000000000000", count=0)

    changes = ProgramChanges(edit)
    attach = AttachObject(op="attach", name="part", joints=HOME)
    changes.remember("p", 2.0, ((0.5, attach), (1.5, DetachObject(op="detach", name="part", joints=HOME))))
    state = GoalState(
        goal_id="g", plan_id="p", status="running", progress=0.3, elapsed=0.6, duration=2.0, joint_command=HOME
    )
    ended = state.model_copy(update={"status": "succeeded", "progress": 1.0})
    for each in (state, state, ended, ended):
        changes.receive("", each)
    assert made == ["attach", "detach"]
    changes.receive("", ended.model_copy(update={"goal_id": "other", "duration": 3.0}))  # replanned
    assert made == ["attach", "detach"]


def test_named_objects_may_be_touched_on_the_approach_only(handlers: Handlers) -> None:
    part = Cuboid(kind="cuboid", name="part", position=at(0.0, 0.25, -0.2), size=(0.06, 0.06, 0.3))
    put(handlers, part)
    down = Offset(distance=0.12, direction=(0.0, 0.0, 1.0))
    touching = down.model_copy(update={"touch": ("part",)})
    inside = (0.0, 0.25, -0.08)  # 3 cm inside the part
    with pytest.raises(PlanningFailed, match="part"):
        planned(handlers, move(pose_goal(*inside, approach=down)))
    plan, _ = planned(
        handlers,
        move(pose_goal(*inside, approach=touching)),
        Attach(kind="attach", object="part", touch_links=("link_6",)),
        move(line(0.0, 0.25, 0.05)),
    )
    first, second = plan.touches
    assert first.objects == second.objects == ("part",)
    assert 0.0 < first.begin < first.end == second.begin == plan.segments[1].begin
    assert second.end == plan.segments[1].end
    assert tip_at(plan, first.begin)[:3, 3] == pytest.approx(at(0.0, 0.25, 0.04), abs=1e-4)
    with pytest.raises(PlanningFailed, match="segment 1"):
        planned(handlers, move(pose_goal(*inside, approach=touching)), move(line(0.0, 0.25, 0.05)))
    with pytest.raises(InvalidRequest, match="no object bin"):
        planned(handlers, move(pose_goal(*inside, approach=down.model_copy(update={"touch": ("bin",)}))))


def test_carried_object_is_kept_from_obstacles(handlers: Handlers) -> None:
    part = Cuboid(kind="cuboid", name="part", position=at(0.0, 0.2, -0.35), size=(0.04, 0.04, 0.3))
    wall = Cuboid(kind="cuboid", name="wall", position=at(0.0, 0.0, -0.35), size=(0.6, 0.02, 0.3))
    put(handlers, part, wall)
    lower = line(0.0, -0.2, -0.18)
    above = pose_goal(0.0, 0.2, -0.18)
    planned(handlers, move(above), move(lower))  # the tool alone passes above the wall
    with pytest.raises(PlanningFailed, match=r"segment 2, carry: .*wall") as failed:
        planned(
            handlers,
            move(above),
            Attach(kind="attach", object="part", touch_links=("link_6",)),
            move(lower, "carry"),
        )
    assert failed.value.problem.field == "segments.2"
    assert failed.value.problem.fraction is not None


@pytest.mark.parametrize(
    ("make", "error", "field", "said"),
    [
        (lambda: (Wait(kind="wait", duration=1.0),), InvalidRequest, "segments", "no segment of the program moves"),
        (
            lambda: (move(line(0.0, 0.1, 0.0)), move(line(0.0, 0.1, 0.0), "seam")),
            InvalidRequest,
            "segments.1.goal.position",
            "segment 1, seam: the line has no extent",
        ),
        (
            lambda: (
                move(line(0.0, 0.1, 0.0)).model_copy(update={"blend": 0.02}),
                move(JointGoal(kind="joints", position=HOME)),
            ),
            InvalidRequest,
            "segments.0.blend",
            "a line or an arc blends into",
        ),
        (
            lambda: (
                move(line(0.0, 0.1, 0.0)).model_copy(update={"blend": 0.2}),
                move(line(0.0, 0.1, 0.1)),
            ),
            InvalidRequest,
            "segments.0.blend",
            "does not fit",
        ),
        (
            lambda: (move(line(0.0, 0.1, 0.0)), Attach(kind="attach", object="part")),
            InvalidRequest,
            "segments.1.name",
            "no object part",
        ),
        (
            lambda: (move(line(0.0, 0.1, 0.0)), Detach(kind="detach", object="part")),
            InvalidRequest,
            "segments.1.name",
            "does not carry part",
        ),
        (
            lambda: (move(line(0.0, 0.1, 0.0)), move(pose_goal(5.0, 0.0, 0.0), "far")),
            PlanningFailed,
            "segments.1.goal",
            "segment 1, far: .*cannot be reached",
        ),
        (
            lambda: (
                move(
                    WaypointsGoal(
                        kind="waypoints",
                        through=(pose_goal(0, 0.1, 0, approach=Offset(distance=0.1, direction=(0, 0, 1))),),
                    )
                ),
            ),
            InvalidRequest,
            "segments.0.goal.through.0.approach",
            "no approach or retreat",
        ),
    ],
)
def test_segment_that_fails_is_named(
    handlers: Handlers, make: Callable[[], tuple[Segment, ...]], error: type[Exception], field: str, said: str
) -> None:
    with pytest.raises(error, match=said) as failed:
        planned(handlers, *make())
    assert failed.value.problem.field == field  # type: ignore[attr-defined]


def test_segments_before_a_failing_one_are_kept_on_request(handlers: Handlers) -> None:
    segments = (
        move(line(0.0, 0.1, 0.0), "first"),
        Wait(kind="wait", duration=1.0),
        move(pose_goal(5.0, 0.0, 0.0), "far"),
    )
    plan, _ = handlers.program(ProgramRequest(segments=segments, partial=True))
    assert plan.problem is not None
    assert plan.problem.field == "segments.2.goal"
    assert [segment.action for segment in plan.segments] == ["move", "wait"]
    assert tip_at(plan, plan.trajectory.duration)[:3, 3] == pytest.approx(at(0.0, 0.1, 0.0), abs=1e-5)
    with pytest.raises(PlanningFailed):
        handlers.program(ProgramRequest(segments=segments[2:], partial=True))


def test_an_approach_that_fails_is_reported_without_a_segment(handlers: Handlers) -> None:
    goal = pose_goal(0.0, 0.3, 0.0, approach=Offset(distance=2.0, direction=(0.0, 0.0, 1.0)))
    with pytest.raises(PlanningFailed) as failed:
        handlers.plan(PlanRequest(start=HOME, goal=goal))
    assert "segment" not in failed.value.problem.message
