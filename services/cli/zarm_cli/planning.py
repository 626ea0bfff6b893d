"""`zarm plan`, and plans as tables and files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.table import Table

from zarm.robot import Robot
from zarm.values import AXES
from zarm_cli.client import AsJson, Connect, Name, connected, joints, message
from zarm_cli.goals import (
    AnyOf,
    AsLine,
    Blend,
    Center,
    Free,
    Group,
    JointsGoal,
    Orienting,
    RotationalSpeed,
    Spline,
    Tip,
    To,
    Tolerance,
    ToleranceFrame,
    ToolAcceleration,
    ToolSpeed,
    TypedGoal,
    Via,
    goal_fields,
    typed_curve,
    typed_freedom,
    typed_goal,
)
from zarm_cli.output import degrees, facts, numbers, out, pose_text, print_json
from zarm_contract.codec import decode, encode
from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Plan, PlanRequest, PlanTorque, PoseDeviation, ToolMotion
from zarm_runtime.session import DEFAULT_ENDPOINT

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
    line: AsLine = False,
    spline: Spline = False,
    via: Via = None,
    center: Center = None,
    blend: Blend = None,
    speed: ToolSpeed = None,
    acceleration: ToolAcceleration = None,
    rotational_speed: RotationalSpeed = None,
    orienting: Orienting = None,
    joints_goal: JointsGoal = None,
    group: Group = None,
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
    hold_group: Annotated[
        str | None, typer.Option(help="Group whose tip is held (default: the group that moves).")
    ] = None,
    relative_to: Annotated[
        str | None,
        typer.Option(
            metavar="GROUP",
            help="Hold it in the frame of the tip of this group, in place of the base; without --hold, all its components.",
        ),
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
    curve = typed_curve(
        line=line,
        spline=spline,
        via=via,
        center=center,
        blend=blend,
        speed=speed,
        acceleration=acceleration,
        rotational_speed=rotational_speed,
        orienting=orienting,
    )
    goal, at, constraint = (
        typed_goal(to, joints_goal, any_of, freedom, curve),
        joints(start, "--start"),
        _constraint(hold, hold_frame, hold_group, relative_to),
    )
    with connected(connect, name) as robot:
        found = request_plan(
            robot,
            goal,
            group=group,
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


def _constraint(
    axes: str | None, frame: str | None, group: str | None, relative_to: str | None
) -> dict[str, object] | None:
    """Read --hold and the options that belong to it; usage error for an unknown axis."""
    if axes is None and relative_to is None:
        for option, given in (("--hold-frame", frame), ("--hold-group", group)):
            if given is not None:
                raise typer.BadParameter("belongs to --hold", param_hint=option)
        return None
    names = AXES if axes is None else axes.split(",")
    if unknown := set(names) - set(AXES):
        raise typer.BadParameter(f"{', '.join(sorted(unknown))}: axes are {', '.join(AXES)}", param_hint="--hold")
    held = [axis in names for axis in AXES]
    return {"axes": held, "frame": frame or "base", "group": group, "relative_to": relative_to}


def request_plan(
    robot: Robot,
    goal: TypedGoal,
    *,
    group: str | None = None,
    start: list[float] | None = None,
    **asked: object,
) -> Plan:
    """Request a plan, see `plan_request`. Ctrl-C cancels the planning too. Raises the planner's error."""
    return robot.request_plan(plan_request(robot, goal, group=group, start=start, **asked))


def plan_request(
    robot: Robot,
    goal: TypedGoal,
    *,
    group: str | None = None,
    start: list[float] | None = None,
    **asked: object,
) -> PlanRequest:
    """The request for a plan of a `group`, or of the robot; `asked` are further fields, without those that are None."""
    return message(PlanRequest, goal=goal_fields(robot, goal, start, group), group=group, start=start, **asked)


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
        *torque_rows(found.torque),
        ("ends at", pose_text(found.tip)),
        *tool_rows(found.tool),
        *((("off the goal", deviation_text(found.goal_deviation)),) if found.goal_deviation else ()),
        ("joints", f"{numbers(found.trajectory.position[-1], 4)} rad = {degrees(found.trajectory.position[-1])} deg"),
    )


def torque_rows(torque: PlanTorque | None) -> list[tuple[str, str]]:
    """What the joints need of their efforts, as rows of a table."""
    if torque is None:
        return []
    slowed = f"; takes {torque.stretch:.2f} times as long for that" if torque.stretch > 1.0 else ""
    return [
        (
            "torque",
            f"at most {100 * torque.share:.0f} % of the effort of {torque.joint}, at {torque.time:.2f} s{slowed}",
        )
    ]


def tool_rows(tool: ToolMotion | None) -> list[tuple[str, str]]:
    """How the tip moves along a curve, as rows of a table."""
    if tool is None:
        return []
    share = f"{100 * tool.speed_share:.0f} % of its way"
    return [
        ("tool", f"{1e3 * tool.length:.1f} mm, at {tool.speed:g} m/s or {tool.rotational_speed:g} rad/s on {share}")
    ]


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
