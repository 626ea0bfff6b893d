"""`zarm plan`, and the goals typed for `plan`, `execute` and `ik`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.table import Table

from zarm.robot import Robot
from zarm.values import AXES, IDENTITY, tolerance_of
from zarm_cli.client import AsJson, Connect, Name, connected, floats, joints, message
from zarm_cli.output import degrees, facts, numbers, out, pose_text, print_json
from zarm_contract.codec import decode, encode
from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Plan, PlanRequest, PoseDeviation, PoseTolerance
from zarm_runtime.session import DEFAULT_ENDPOINT

To = Annotated[
    list[str] | None,
    typer.Option(
        metavar="X,Y,Z[,QX,QY,QZ,QW]",
        help="Pose of the tip in the base frame (m). Without an orientation the tip keeps its own. "
        "Given several times: one motion through all of them in this order, without stopping.",
    ),
]
AnyOf = Annotated[bool, typer.Option("--any", help="Of several --to, go to the one that takes the least time.")]
Free = Annotated[
    str | None,
    typer.Option(metavar="AXIS,...", help=f"Components of --to that may have any value: {', '.join(AXES)}."),
]
Tolerance = Annotated[
    str | None,
    typer.Option(
        metavar="AXIS=VALUE,...",
        help="How far components of --to may be off (rad, m): theta_x=0.1,z=0.01. Or `radius` (m): anywhere in a ball.",
    ),
]
ToleranceFrame = Annotated[
    Literal["base", "tool"] | None,
    typer.Option(help="Axes of x, y and z in --free and --tolerance (default: tool, those of the goal)."),
]
Tip = Annotated[
    str | None, typer.Option(metavar="LINK", help="Link or attached object to bring to --to (default: the tip).")
]
JointsGoal = Annotated[
    str | None, typer.Option("--joints", metavar="A,B,C,...", help="Joint positions (rad), in the descriptor's order.")
]
VelocityScale = Annotated[
    float | None, typer.Option(help="Fraction of the joint velocity limits, above 0 and up to 1.")
]


def plan(
    to: To = None,
    any_of: AnyOf = False,
    free: Free = None,
    tolerance: Tolerance = None,
    tolerance_frame: ToleranceFrame = None,
    tip: Tip = None,
    joints_goal: JointsGoal = None,
    start: Annotated[
        str | None,
        typer.Option(metavar="A,B,C,...", help="Joint positions at the start (default: measured)."),
    ] = None,
    hold: Annotated[
        str | None,
        typer.Option(
            metavar="AXIS,...",
            help=f"Path constraint: hold these components of the tip pose ({', '.join(AXES)}) as at the start.",
        ),
    ] = None,
    hold_frame: Annotated[
        Literal["base", "tool"] | None, typer.Option(help="Frame of the path constraint (default: base).")
    ] = None,
    timeout: Annotated[float | None, typer.Option(help="Deadline for planning (s).")] = None,
    optimize: Annotated[float | None, typer.Option(help="Time to spend on faster trajectories (s).")] = None,
    velocity_scale: VelocityScale = None,
    seed: Annotated[int, typer.Option(help="The same seed, scene and request give the same plan.")] = 0,
    save: Annotated[Path | None, typer.Option(help="Write the plan to this file, for `zarm execute --plan`.")] = None,
    as_json: AsJson = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Plan a motion around the scene; nothing moves."""
    freedom = typed_freedom(free, tolerance, tolerance_frame, tip)
    goal, at, constraint = (
        typed_goal(to, joints_goal, any_of, freedom),
        joints(start, "--start"),
        _constraint(hold, hold_frame),
    )
    with connected(connect, name) as robot:
        found = request_plan(
            robot,
            goal,
            start=at,
            path_constraint=constraint,
            timeout=timeout,
            optimize_s=optimize,
            velocity_scale=velocity_scale,
            seed=seed,
        )
    if save is not None:
        _write_text(save, encode(found).decode() + "\n")
    if as_json:
        print_json(found)
    else:
        table = plan_table(found)
        if any_of:
            table.add_row("goal", f"--to number {found.selected_goal_index} of {len(goal.poses)}, from 0")
        out.print(table)


@dataclass(frozen=True)
class Freedom:
    """What typed poses leave open: their tolerance, and the frame that is brought there."""

    tolerance: PoseTolerance | None = None
    tip: str | None = None

    @property
    def needs_orientation(self) -> bool:
        """Whether the orientation of a typed pose matters."""
        return self.tolerance is None or self.tolerance.orientation != ("free", "free", "free")

    @property
    def fields(self) -> dict[str, object]:
        """The fields of a goal or of an `IkRequest`."""
        return {"tolerance": self.tolerance, "tip": None if self.tip is None else {"link": self.tip}}


EXACT = Freedom()
"""No freedom at all."""


def typed_freedom(
    free: str | None, tolerance: str | None, frame: Literal["base", "tool"] | None, tip: str | None
) -> Freedom:
    """Read --free, --tolerance, --tolerance-frame and --tip; usage error for an unknown axis or value."""
    bounds: dict[str, float] = {}
    for part in tolerance.split(",") if tolerance else ():
        axis, _, value = part.partition("=")
        (bounds[axis],) = floats(value, "--tolerance", 1)
    radius = bounds.pop("radius", None)
    try:
        allowed = tolerance_of(free.split(",") if free else (), bounds, radius, frame or "tool")
    except InvalidRequest as error:
        hint = "--free" if error.problem.field == "free" else "--tolerance"
        raise typer.BadParameter(error.problem.message, param_hint=hint) from None
    if frame is not None and allowed is None:
        raise typer.BadParameter("belongs to --free or --tolerance", param_hint="--tolerance-frame")
    return Freedom(allowed, tip)


@dataclass(frozen=True)
class TypedGoal:
    """A typed goal: joints (rad), or tip poses whose orientation is optional.

    With `any_of` the motion goes to one of the poses, otherwise through all.
    """

    joints: list[float] | None
    poses: list[list[float]]
    any_of: bool
    freedom: Freedom


def typed_goal(to: list[str] | None, joints_goal: str | None, any_of: bool, freedom: Freedom = EXACT) -> TypedGoal:
    """Read --to and --joints, one of which must be given, --any and the freedom; usage error otherwise."""
    if bool(to) == (joints_goal is not None):
        raise typer.BadParameter("give exactly one of them", param_hint="--to / --joints")
    if any_of and not to:
        raise typer.BadParameter("belongs to --to", param_hint="--any")
    if freedom != EXACT and not to:
        raise typer.BadParameter("belong to --to", param_hint="--free / --tolerance / --tip")
    poses = [floats(pose, "--to", 3, 7) for pose in to or []]
    return TypedGoal(joints(joints_goal, "--joints"), poses, any_of, freedom)


def _constraint(axes: str | None, frame: str | None) -> dict[str, object] | None:
    """Read --hold and --hold-frame; usage error for an unknown axis."""
    if axes is None:
        if frame is not None:
            raise typer.BadParameter("belongs to --hold", param_hint="--hold-frame")
        return None
    names = axes.split(",")
    if unknown := set(names) - set(AXES):
        raise typer.BadParameter(f"{', '.join(sorted(unknown))}: axes are {', '.join(AXES)}", param_hint="--hold")
    return {"axes": [axis in names for axis in AXES], "frame": frame or "base"}


def request_plan(robot: Robot, goal: TypedGoal, *, start: list[float] | None = None, **asked: object) -> Plan:
    """Request a plan; `asked` are further fields of PlanRequest, without those that are None. Ctrl-C cancels the
    planning too.

    Raises the planner's error.
    """
    return robot.request_plan(message(PlanRequest, goal=_goal(robot, goal, start), start=start, **asked))


def _goal(robot: Robot, typed: TypedGoal, start: list[float] | None) -> dict[str, object]:
    if typed.joints is not None:
        return {"kind": "joints", "position": typed.joints}
    freedom = typed.freedom
    poses = [full_pose(robot, pose, start, oriented=freedom.needs_orientation) for pose in typed.poses]
    if typed.any_of or len(poses) == 1:
        return {"kind": "pose", **poses[0], "alternatives": poses[1:], **freedom.fields}
    return {"kind": "waypoints", "through": [{"kind": "pose", **pose, **freedom.fields} for pose in poses]}


def full_pose(
    robot: Robot, typed: list[float], at: list[float] | None = None, *, oriented: bool = True
) -> dict[str, list[float]]:
    """Position and orientation of a typed pose; by default the orientation is the tip's at the joints `at`, or
    measured, if it is to be `oriented` at all.
    """
    if len(typed) == 3 and not oriented:
        typed = [*typed, *IDENTITY]
    if len(typed) == 3:
        typed = [*typed, *(robot.tip() if at is None else robot.fk([at])[0]).orientation]
    return {"position": typed[:3], "orientation": typed[3:]}


def plan_table(found: Plan) -> Table:
    """A plan as a readable table."""
    times = found.timings
    stages = ("ik", "search", "shortcut", "timing", "verify", "optimize")
    shares = ", ".join(f"{stage} {getattr(times, stage) * 1e3:.1f}" for stage in stages)
    return facts(
        ("plan", found.plan_id),
        ("found in", f"{times.total * 1e3:.1f} ms ({shares})"),
        ("motion", f"{found.trajectory.duration:.2f} s, {found.path_length:.2f} rad"),
        *((("passes", f"its waypoints at {numbers(found.waypoint_times)} s"),) if found.waypoint_times else ()),
        ("clearance", f"{found.clearance * 1e3:.1f} mm at the closest, in scene revision {found.scene_revision}"),
        ("ends at", pose_text(found.tip)),
        *((("off the goal", deviation_text(found.goal_deviation)),) if found.goal_deviation else ()),
        ("joints", f"{numbers(found.trajectory.position[-1], 4)} rad = {degrees(found.trajectory.position[-1])} deg"),
    )


def deviation_text(deviation: PoseDeviation) -> str:
    """How far a pose is from another."""
    angles, distances = deviation[:3], deviation[3:]
    return f"{numbers([1e3 * x for x in distances], 1)} mm, {degrees(angles)} deg in the goal's frame"


def read_plan(path: Path) -> Plan:
    """A plan that `zarm plan --save` wrote. Raises InvalidRequest that names the file."""
    try:
        return decode(Plan, path.read_bytes())
    except OSError as error:
        raise InvalidRequest(f"cannot read {path}: {error.strerror}") from error
    except InvalidRequest as error:
        raise InvalidRequest(
            f"{path} holds no plan: {error.problem.message}; plan again with this version of zarm, and save it anew",
            field=error.problem.field,
        ) from error


def _write_text(path: Path, text: str) -> None:
    """Write a file. Raises InvalidRequest if it cannot be written."""
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InvalidRequest(f"cannot write {path}: {error.strerror}") from error
