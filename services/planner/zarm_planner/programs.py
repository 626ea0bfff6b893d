"""Programs: segments planned one after the other, each from where the one before it ends, and joined to one motion.

Where a motion leads to a pose that can be reached in several ways, the lines, arcs and paths after it decide which: only
from some of them can all of these be followed.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from zarm_contract.errors import InvalidRequest, PlanningFailed, Problem, ZarmError, from_problem
from zarm_contract.messages import (
    ArcGoal,
    Attach,
    AttachObject,
    CartesianGoal,
    Detach,
    DetachObject,
    Goal,
    Grip,
    JointGoal,
    LineGoal,
    Move,
    Offset,
    OutputRequest,
    PathGoal,
    PathPoint,
    PlannedGrip,
    PlannedSegment,
    PoseGoal,
    Segment,
    SetOutput,
    SpeedChange,
    TipFrame,
    Touch,
    Wait,
    WaypointsGoal,
)
from zarm_contract.robot import RobotDescription
from zarm_geometry.frames import pose_of
from zarm_planner.cartesian.following import Following
from zarm_planner.cartesian.task import ToolTask
from zarm_planner.context import PlanningContext
from zarm_planner.goals.ends import goal_deviation
from zarm_planner.goals.problem import PlanningProblem
from zarm_planner.group import Group
from zarm_planner.kinematics.pose_region import tip_frame
from zarm_planner.pipeline import Verified, plan
from zarm_planner.planners.base import Planner
from zarm_planner.planners.registry import AUTO, choose
from zarm_planner.timing.sampling import MAX_SAMPLES
from zarm_planner.timing.time_parameterization import joined
from zarm_trajectory.arrays import Array
from zarm_trajectory.trajectory import TimedTrajectory

ALONG_CURVE = {*LineGoal.model_fields} & {*PathGoal.model_fields} - {"kind"}
"""The fields that lines and paths have in common."""
CHANGE_S = 0.2
"""s for which the robot rests while something is attached or detached: the planner edits the scene meanwhile."""
STOP_S = 0.5
"""s for which the robot rests where a gripper moves or an output is switched, besides the time that this takes: it is held within them."""
_PASSING_DISTANCES = 0.0005, 0.1
"""m by which free motions that blend pass the pose between them, at least and at most: what waypoints allow."""
_TURNED = 0.5
"""rad by which the tip may be turned there."""
_PART = re.compile(r"goal\.(?:points|through)\.(\d+)\.?(.*)")
"""A field of one of several motions that are planned as one."""
_CANDIDATES = 16
"""Most configurations from which the curves after a motion are tried."""

Scales = tuple[float | None, float | None]
"""Shares of the limits of velocity and acceleration, or None for those of the request."""
SceneChange = AttachObject | DetachObject
ChangeAt = tuple[float, SceneChange]
"""What a program attaches or detaches at which time (s)."""


class Stage(Protocol):
    """The surroundings of a program's segments."""

    robot: RobotDescription

    def context(self, scales: Scales, touch: Collection[str] = ()) -> PlanningContext:
        """The context of a motion, with the scene as it is at that point of the program, without the objects that it may
        touch. Raises InvalidRequest for one that is not in the scene.
        """

    def change(self, change: SceneChange, q: Array) -> None:
        """Attach or detach an object with the robot at `q` (dof,). Raises InvalidRequest."""

    def grip(self, grip: Grip) -> PlannedGrip:
        """Have a gripper at another opening from here on; returns what the executor is to do. Raises InvalidRequest."""


@dataclass(frozen=True)
class PlannedProgram:
    """A program as one motion. `changes` say what is attached or detached at which time (s), and the joints (dof,) there;
    `touches` where objects may be touched, and `groups` which groups moved last, none if that was the whole robot. With a `problem` it
    ends before the segment that fails.
    """

    verified: Verified
    segments: tuple[PlannedSegment, ...]
    changes: tuple[tuple[float, SceneChange, Array], ...]
    touches: tuple[Touch, ...]
    groups: tuple[str, ...] = ()
    problem: Problem | None = None


@dataclass
class _Progress:
    """What is planned so far."""

    q: Array
    parts: list[Verified] = field(default_factory=list)
    motions: list[TimedTrajectory] = field(default_factory=list)
    touches: list[Touch] = field(default_factory=list)
    time: float = 0.0
    groups: tuple[str, ...] = ()

    def kept(self) -> _Progress:
        """What is planned now, whatever is added later."""
        return _Progress(self.q, self.parts.copy(), self.motions.copy(), self.touches.copy(), self.time, self.groups)

    def add(self, motion: TimedTrajectory, touch: tuple[str, ...] = ()) -> None:
        if touch:
            self.touches.append(Touch(objects=touch, begin=self.time, end=self.time + motion.duration))
        self.motions.append(motion)
        self.time += motion.duration
        self.q = motion.end


def plan_program(
    stage: Stage,
    start: Array,
    segments: Sequence[Segment],
    planners: Sequence[Planner],
    check: Callable[[], None],
    *,
    partial: bool = False,
) -> PlannedProgram:
    """The motion of a program from the joints `start` (dof,).

    Raises the error of the first segment that fails, which its message and field name, unless the `partial` motion before it
    is wanted and there is one; `check` may raise the deadline's.
    """
    done, changes = _Progress(start), []
    planned: list[PlannedSegment] = []
    scales: Scales = (None, None)
    # By the motion before: while it stands, the robot may still touch that, and what it may touch next.
    touched: tuple[str, ...] = ()
    passed = 0  # segments that are planned together with one before
    for number, segment in enumerate(segments):
        if passed:
            passed -= 1
            continue
        whole = done.kept()
        begin, standing = done.time, tuple({*touched, *_touch_after(segments[number + 1 :])})
        together: Sequence[Segment] = (segment,)
        grip: PlannedGrip | None = None
        output: OutputRequest | None = None
        check()
        try:
            match segment:
                case Move(touch=touch):
                    together, goal = blended(segments[number:])
                    after = _curves_after(segments[number + len(together) :], segment.group)
                    group = Group.of(stage.robot, segment.group, goal)
                    done.groups = group.names if group is not None else ()
                    motions = _Motions(stage, scales, touch, planners, group, done.q)
                    for verified, touched in motions.of(goal, after):
                        done.parts.append(verified.begun_at(done.time))
                        done.add(verified.trajectory, touched)
                case Wait(duration=duration):
                    done.add(TimedTrajectory.standing(done.q, duration), standing)
                case SpeedChange():
                    scales = segment.velocity_scale, segment.acceleration_scale
                case Attach() | Detach():
                    change = _change(segment)
                    stage.change(change, done.q)
                    touched = tuple(name for name in touched if name != change.name)  # it is carried, or put down
                    changes.append((done.time, change, done.q))
                    done.add(TimedTrajectory.standing(done.q, CHANGE_S), standing)
                case Grip():
                    grip = stage.grip(segment)
                    _check_standing(stage.context(scales, standing), done.q, grip)
                    done.add(TimedTrajectory.standing(done.q, STOP_S), standing)
                case SetOutput():
                    output = _output(stage.robot, segment)
                    done.add(TimedTrajectory.standing(done.q, STOP_S), standing)
        except ZarmError as error:
            failure = _of_segment(error, number, segment, together)
            if not partial or not whole.parts:
                raise failure from error
            return PlannedProgram(
                _whole(whole), tuple(planned), tuple(changes), tuple(whole.touches), whole.groups, failure.problem
            )
        passed = len(together) - 1
        ends = [*_passing_times(stage, done, begin, together), done.time]
        for one, (first, last) in zip(together, itertools.pairwise([begin, *ends]), strict=True):
            planned.append(
                PlannedSegment(action=one.kind, name=one.name, begin=first, end=last, grip=grip, output=output)
            )
    if not done.parts:
        raise InvalidRequest("no segment of the program moves the robot; add one of kind move", field="segments")
    return PlannedProgram(_whole(done), tuple(planned), tuple(changes), tuple(done.touches), done.groups)


def _output(robot: RobotDescription, segment: SetOutput) -> OutputRequest:
    """What the executor is to do. Raises InvalidRequest for an output that the robot has not."""
    known = robot.descriptor.outputs
    if segment.output not in known:
        has = f"this robot has {', '.join(known)}" if known else "describe it in `outputs` of the robot's descriptor"
        raise InvalidRequest(f"there is no output {segment.output}; {has}", field="output")
    return OutputRequest(output=segment.output, on=segment.on)


def _check_standing(context: PlanningContext, q: Array, grip: PlannedGrip) -> None:
    """Raises PlanningFailed if the fingers would touch something that they may not when they stand."""
    nearest = context.exact.nearest(q, context.deadline.check)
    if nearest.distance <= 0.0:
        a, b = nearest.pair or ("the robot", "itself")
        raise PlanningFailed(
            f"with {grip.gripper} at {grip.width:g} m {a} would touch {b}; name what it may touch in `touch` of the motion before",
            code="start_in_collision",
        )


def blended(segments: Sequence[Segment]) -> tuple[Sequence[Segment], Goal]:
    """The first segments that are one motion, because each blends into the next, and its goal.

    Raises InvalidRequest for a segment that blends into none.
    """
    first = segments[0]
    if not isinstance(first, Move):
        raise TypeError("only moves blend")
    together = [first]
    for segment in segments[1:]:
        if together[-1].blend == 0.0 or not isinstance(segment, Move) or _options(segment) != _options(first):
            break
        together.append(segment)
    if together[-1].blend > 0.0:
        raise InvalidRequest(
            "a line or an arc blends into a line or an arc of the next segment with the same options, and a free motion into a free one; set "
            "blend to 0",
            field="blend",
        )
    if len(together) == 1:
        return together, first.goal
    if isinstance(first.goal, LineGoal | ArcGoal):
        fields = first.goal.model_dump(include=ALONG_CURVE)
        points = tuple(_point(move) for move in together)
        return together, PathGoal(kind="path", points=points, **fields)
    goals = tuple(move.goal for move in together if isinstance(move.goal, PoseGoal | JointGoal))
    near = min(move.blend for move in together[:-1])
    tolerances = {
        "position_tolerance": min(max(near, _PASSING_DISTANCES[0]), _PASSING_DISTANCES[1]),
        "angle_tolerance": _TURNED,
    }
    return together, WaypointsGoal(kind="waypoints", through=goals, **tolerances)


def _point(move: Move) -> PathPoint:
    """Where a line or an arc ends, as a point of a path."""
    shared = move.goal.model_dump(include={"position", "orientation", "via", "center"})
    return PathPoint(**shared, blend=move.blend)


def _options(segment: Move) -> tuple[object, ...]:
    """What motions that blend have in common; those that never blend have nothing in common with others."""
    goal, own = segment.goal, (segment.touch, segment.group)
    if isinstance(goal, LineGoal | ArcGoal):
        return goal.model_dump(include=ALONG_CURVE), *own
    free = isinstance(goal, JointGoal) or (isinstance(goal, PoseGoal) and not with_ways(goal))
    return ("free" if free else id(segment), *own)


def _passing_times(stage: Stage, done: _Progress, begin: float, together: Sequence[Segment]) -> list[float]:
    """When (s) the robot passes the ends of these motions but the last: where the tip is nearest to them, or passes a waypoint."""
    if len(together) == 1:
        return []
    if done.parts[-1].waypoint_times:
        return [begin + time for time in done.parts[-1].waypoint_times[:-1]]
    curves = [one.goal for one in together if isinstance(one, Move) and isinstance(one.goal, LineGoal | ArcGoal)][:-1]
    model, trajectory = stage.context((None, None)).model, done.motions[-1]
    tip = curves[0].tip or TipFrame(link=stage.robot.tip_of(done.groups))
    joint, frame = tip_frame(model, tip, "goal.tip")
    tips = (model.fk_joint(joint, trajectory.position) @ frame)[:, :3, 3]
    times, at = [], 0
    for curve in curves:
        at += int(np.argmin(np.linalg.norm(tips[at:] - curve.position, axis=1)))
        times.append(begin + float(trajectory.time[at]))
    return times


def with_ways(goal: Goal) -> bool:
    """Whether a goal asks for an approach or a retreat, and so for several motions."""
    return isinstance(goal, PoseGoal) and (goal.approach is not None or goal.retreat is not None)


def _change(segment: Attach | Detach) -> SceneChange:
    if isinstance(segment, Attach):
        return AttachObject(
            op="attach",
            name=segment.object,
            touch_links=segment.touch_links,
            link=segment.link,
            mass=segment.mass,
            center=segment.center,
        )
    return DetachObject(op="detach", name=segment.object)


def _touch_after(segments: Sequence[Segment]) -> tuple[str, ...]:
    """What the next motion may touch."""
    return next((segment.touch for segment in segments if isinstance(segment, Move)), ())


def _curves_after(segments: Sequence[Segment], group: str | None) -> list[CartesianGoal]:
    """The lines, arcs and paths of a group that follow, up to the next motion that is free to choose its way."""
    curves: list[CartesianGoal] = []
    for segment in segments:
        if isinstance(segment, Move):
            if not isinstance(segment.goal, CartesianGoal) or segment.group != group:
                break
            curves.append(segment.goal)
    return curves


@dataclass(frozen=True)
class _Motions:
    """Plans the motions of one segment, which may touch the objects `touch` on all of them, of a group or of all joints, from the
    robot's joints `start` (dof,) on.
    """

    stage: Stage
    scales: Scales
    touch: tuple[str, ...]
    planners: Sequence[Planner]
    group: Group | None
    start: Array

    def of(self, goal: Goal, after: Sequence[CartesianGoal]) -> Iterator[tuple[Verified, tuple[str, ...]]]:
        """The motions of the robot, each with what it may touch: to where a goal's approach begins, along it, along its
        retreat; or the only one. `after` are the curves that follow.
        """
        if self.group is None:
            yield from self._motions(self.start, goal, after)
            return
        for verified, touched in self._motions(self.start[self.group.joints], goal, after):
            yield self.group.whole(verified, self.start), touched

    def _context(self, touch: tuple[str, ...]) -> PlanningContext:
        context = self.stage.context(self.scales, touch)
        return context if self.group is None else self.group.context(context, self.start)

    def _motions(
        self, q: Array, goal: Goal, after: Sequence[CartesianGoal]
    ) -> Iterator[tuple[Verified, tuple[str, ...]]]:
        """The same for the joints that move, from `q` on."""
        context = self._context(self.touch)
        if not isinstance(goal, PoseGoal) or not (after or with_ways(goal)):
            yield _planned(context, q, goal, self.planners), self.touch
            return
        at_pose = tuple({*self.touch, *(name for way in (goal.approach, goal.retreat) if way for name in way.touch)})
        near = context if set(at_pose) == set(self.touch) else self._context(at_pose)
        bare = goal.model_copy(update={"approach": None, "retreat": None})
        with near.timer.stage("ik"):
            ends = PlanningProblem.of(near, q, bare).targets[-1]
        failure: ZarmError | None = None
        for end in ends[:_CANDIDATES]:
            context.deadline.check()
            try:
                begin, ways = _ways(near, end.asked, goal)
                _follow(near, begin, [*ways, *after])  # what is touched may be attached before those after it
                joints = JointGoal(kind="joints", position=tuple(begin.tolist()))
                motions = [_planned(context if ways else near, q, joints, self.planners)]
                for way in ways:
                    motions.append(_planned(near, motions[-1].trajectory.end, way, self.planners))
            except PlanningFailed as error:
                failure = failure or error
                continue
            at = motions[-2 if goal.retreat is not None else -1].trajectory.end
            off = goal_deviation(near, bare, end.pose, at)
            motions[-1] = replace(motions[-1], goal_pose=end.pose, deviation=off)
            yield motions[0], self.touch
            yield from ((motion, at_pose) for motion in motions[1:])
            return
        if failure is not None and with_ways(goal):
            raise failure
        yield _planned(context, q, bare, self.planners), self.touch  # the curve then says how far it can be followed


def _ways(context: PlanningContext, q: Array, goal: PoseGoal) -> tuple[Array, list[CartesianGoal]]:
    """Where the approach to the configuration `q` (dof,) begins, and the lines from there: to the pose, and the retreat.

    Raises PlanningFailed if the approach cannot be followed.
    """
    joint, frame = tip_frame(context.model, goal.tip, "goal.tip")
    pose = context.model.fk_joint(joint, q) @ frame
    ways: list[CartesianGoal] = []
    begin = q
    if goal.approach is not None:
        before = _line_to(pose, _shift(pose, goal.approach, -1.0), goal)
        begin = _followed(context, q, before)
        ways.append(_line_to(pose, pose[:3, 3], goal))
    if goal.retreat is not None:
        ways.append(_line_to(pose, _shift(pose, goal.retreat, 1.0), goal))
    return begin, ways


def _line_to(pose: Array, position: Array, goal: PoseGoal) -> LineGoal:
    x, y, z = position.tolist()
    return LineGoal(kind="line", position=(x, y, z), orientation=pose_of(pose).orientation, tip=goal.tip)


def _shift(pose: Array, offset: Offset, sign: float) -> Array:
    direction = np.array(offset.direction) / np.linalg.norm(offset.direction)
    along = pose[:3, :3] @ direction if offset.frame == "tool" else direction
    return np.asarray(pose[:3, 3] + sign * offset.distance * along)


def _follow(context: PlanningContext, q: Array, curves: Sequence[CartesianGoal]) -> None:
    """Raises PlanningFailed unless all curves can be followed from the joints `q` (dof,), one after the other."""
    for curve in curves:
        q = _followed(context, q, curve)


def _followed(context: PlanningContext, q: Array, goal: CartesianGoal) -> Array:
    """Where a curve from `q` (dof,) ends. Raises PlanningFailed if it cannot be followed, or collides."""
    task = ToolTask.of(context.model, goal, q)
    with context.timer.stage("search"):
        path = Following(context.scene, context.deadline, context.seed, task.curve, task, q).path()
    if not context.exact.is_free(path, context.deadline.check):
        a, b = context.exact.nearest(path, context.deadline.check).pair or ("the robot", "itself")
        raise PlanningFailed(f"along the curve {a} would touch {b}; clear the way, or move the curve", code="no_path")
    return np.asarray(path[-1])


def _planned(context: PlanningContext, q: Array, goal: Goal, planners: Sequence[Planner]) -> Verified:
    return plan(choose(AUTO, goal, False, planners=planners), context, q, goal)


def _whole(done: _Progress) -> Verified:
    """All motions as one, with the smallest clearance of any."""
    trajectory = joined(done.motions)
    if len(trajectory.time) > MAX_SAMPLES:
        raise InvalidRequest(
            f"the program lasts {trajectory.duration:.0f} s and needs more than the {MAX_SAMPLES} samples that one message holds; "
            "split it",
            field="segments",
        )
    last = done.parts[-1]
    return replace(
        last,
        trajectory=trajectory,
        clearance=min(part.clearance for part in done.parts),
        too_near=tuple(near for part in done.parts for near in part.too_near),
        waypoint_times=(),
        tool=last.tool if len(done.motions) == 1 else None,
        torque=max(
            (part.torque for part in done.parts if part.torque is not None), key=lambda use: use.share, default=None
        ),
    )


def _of_segment(error: ZarmError, number: int, segment: Segment, together: Sequence[Segment]) -> ZarmError:
    """The error of a segment, which it names; those that blend were planned as one motion."""
    problem = error.problem
    where = problem.field
    if len(together) > 1 and where is not None:
        if found := _PART.match(where):
            offset = int(found[1])
            number, segment = number + offset, together[offset]
            where = f"goal.{found[2] or 'position'}"
        elif where == "goal.blend":
            where = "blend"
    called = f"segment {number}" + (f", {segment.name}" if segment.name else "")
    at = f"segments.{number}" + (f".{where.removeprefix('edit.')}" if where and where != "start" else "")
    return from_problem(problem.model_copy(update={"message": f"{called}: {problem.message}", "field": at}))


def of_only_segment(error: ZarmError) -> ZarmError:
    """The error of a program's only segment, without the segment's number."""
    problem = error.problem
    field = None if problem.field is None else problem.field.removeprefix("segments.0").removeprefix(".") or None
    return from_problem(
        problem.model_copy(update={"message": problem.message.removeprefix("segment 0: "), "field": field})
    )
