"""`zarm plan`, and the goals typed for `plan`, `execute` and `ik`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.table import Table

from zarm.robot import Robot
from zarm.values import AXES
from zarm_cli.client import AsJson, Connect, Name, connected, floats, joints, message
from zarm_cli.output import degrees, facts, numbers, out, pose_text, print_json
from zarm_contract.codec import decode, encode
from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Plan, PlanRequest
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
JointsGoal = Annotated[
    str | None, typer.Option("--joints", metavar="A,B,C,...", help="Joint positions (rad), in the descriptor's order.")
]
VelocityScale = Annotated[
    float | None, typer.Option(help="Fraction of the joint velocity limits, above 0 and up to 1.")
]


def plan(
    to: To = None,
    any_of: AnyOf = False,
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
    goal, at, constraint = typed_goal(to, joints_goal, any_of), joints(start, "--start"), _constraint(hold, hold_frame)
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
class TypedGoal:
    """A typed goal: joints (rad), or tip poses whose orientation is optional.

    With `any_of` the motion goes to one of the poses, otherwise through all.
    """

    joints: list[float] | None
    poses: list[list[float]]
    any_of: bool


def typed_goal(to: list[str] | None, joints_goal: str | None, any_of: bool) -> TypedGoal:
    """Read --to and --joints, one of which must be given, and --any; usage error otherwise."""
    if bool(to) == (joints_goal is not None):
        raise typer.BadParameter("give exactly one of them", param_hint="--to / --joints")
    if any_of and not to:
        raise typer.BadParameter("belongs to --to", param_hint="--any")
    return TypedGoal(joints(joints_goal, "--joints"), [floats(pose, "--to", 3, 7) for pose in to or []], any_of)


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
    poses = [full_pose(robot, pose, start) for pose in typed.poses]
    if typed.any_of or len(poses) == 1:
        return {"kind": "pose", **poses[0], "alternatives": poses[1:]}
    return {"kind": "waypoints", "through": [{"kind": "pose", **pose} for pose in poses]}


def full_pose(robot: Robot, typed: list[float], at: list[float] | None = None) -> dict[str, list[float]]:
    """Position and orientation of a typed pose; by default the orientation is the tip's at the joints `at`, or
    measured.
    """
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
        ("joints", f"{numbers(found.trajectory.position[-1], 4)} rad = {degrees(found.trajectory.position[-1])} deg"),
    )


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
