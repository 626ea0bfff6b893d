"""`zarm execute`, and the commands that stop, pause, resume and reset the robot."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import typer

from zarm.executor import REST_SECONDS
from zarm.robot import Robot
from zarm_cli.client import AsJson, Connect, Name, connected, message
from zarm_cli.goals import (
    EXACT,
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
    Via,
    typed_curve,
    typed_freedom,
    typed_goal,
)
from zarm_cli.output import SCENE_CHANGED, err, facts, held_by, out, print_json, reached, share_text
from zarm_cli.planning import VelocityScale, plan_request, read_plan, request_plan
from zarm_contract.errors import InvalidRequest, ZarmError, from_problem
from zarm_contract.messages import ExecuteRequest, ExecutorState, GoalState, PlannedSegment, Speed
from zarm_runtime.session import DEFAULT_ENDPOINT


def execute(
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
    plan: Annotated[Path | None, typer.Option(help="A plan saved by `zarm plan --save`.")] = None,
    plan_id: Annotated[str | None, typer.Option(help="Id of a plan published on this bus.")] = None,
    velocity_scale: VelocityScale = None,
    preempt: Annotated[
        bool, typer.Option("--preempt", help="Cancel the active goal first, and start when the robot rests.")
    ] = False,
    replan: Annotated[bool, typer.Option("--replan", help="Replan during motion when an obstacle appears.")] = False,
    alongside: Annotated[
        bool, typer.Option("--alongside", help="Move the --group while the active goal moves other joints.")
    ] = False,
    as_json: AsJson = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Move the robot along the last plan, a given one, or a new one (--to, --joints). Ctrl-C stops the robot."""
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
    typed = to or joints_goal is not None or any_of or freedom != EXACT or curve is not None
    goal = typed_goal(to, joints_goal, any_of, freedom, curve) if typed else None
    if [plan, plan_id, goal].count(None) < 2:
        raise typer.BadParameter("give one of them at most", param_hint="--plan / --plan-id / --to / --joints")
    for given, hint in ((velocity_scale, "--velocity-scale"), (group, "--group")):
        if given is not None and goal is None:
            raise typer.BadParameter("belongs to --to or --joints", param_hint=hint)
    if alongside and (goal is None or preempt or replan):
        raise typer.BadParameter(
            "belongs to --to or --joints, without --preempt and --replan", param_hint="--alongside"
        )
    request = message(ExecuteRequest, plan_id=plan_id) if plan is None else _saved(plan)
    with connected(connect, name) as robot:
        if goal is not None and not alongside:
            if preempt:
                _bring_to_rest(robot)
            request = ExecuteRequest(
                plan_id=request_plan(robot, goal, group=group, velocity_scale=velocity_scale).plan_id
            )
        if alongside and goal is not None:
            from zarm.alongside import execute_alongside  # takes long, and a stop does not need it

            asked = plan_request(robot, goal, group=group, velocity_scale=velocity_scale)
            last = execute_alongside(robot.planner, robot.executor, asked)
        else:
            last = run_goal(robot, request, preempt=preempt, replan=replan)
    if as_json:
        print_json(last)
    demand_success(last)
    if not as_json:
        out.print(f"{last.status} after {last.elapsed:.2f} s in motion (goal {last.goal_id})")


def _saved(file: Path) -> ExecuteRequest:
    """The request to execute a saved plan. It contains the motion itself, so no service has to remember that plan."""
    plan = read_plan(file)
    acts = next((segment.action for segment in plan.segments if segment.action in ("grip", "attach", "detach")), None)
    if acts is not None:
        raise InvalidRequest(
            f"{file} is the plan of a program with a segment that would be left out, {acts}; run the program: `zarm program run`"
        )
    return ExecuteRequest(trajectory=plan.trajectory, scene_revision=plan.scene_revision, openings=plan.openings)


def _bring_to_rest(robot: Robot) -> None:
    """Cancel the running goal, if any, and wait for its end: a motion is planned from where the robot comes to rest."""
    goal_id = robot.cancel().goal_id
    if goal_id is not None:
        robot.follow(goal_id, timeout=REST_SECONDS)


def demand_success(last: GoalState) -> None:
    """Raise the problem of a goal that did not succeed."""
    if last.problem is not None:
        raise from_problem(last.problem)


def run_goal(
    robot: Robot,
    request: ExecuteRequest,
    *,
    preempt: bool = False,
    replan: bool = False,
    segments: Sequence[PlannedSegment] = (),
) -> GoalState:
    """Execute with a progress bar and return the goal's last state; Ctrl-C cancels and waits until the robot stands. The bar names
    those of a program's `segments`.
    """
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn  # not needed for a stop

    last: GoalState | None = None
    columns = (
        TextColumn("{task.description}"),
        BarColumn(None),
        TaskProgressColumn(),
        TextColumn("{task.fields[time]}"),
    )
    with Progress(*columns, console=err, transient=True, disable=not err.is_terminal) as bar:
        task = bar.add_task("accepted", total=1.0, time="")

        def show(state: GoalState) -> None:
            nonlocal last
            if last is None:
                _warn_of_edits(robot, state.goal_id)
            last = state
            bar.update(
                task,
                description=state.status
                if state.segment is None
                else f"{state.status} {_called(segments, state.segment)}",
                completed=state.progress,
                time=reached(state),
            )

        try:
            return robot.execute(request, preempt=preempt, replan=replan, on_progress=show)
        except KeyboardInterrupt as interruption:
            err.print(f"zarm: {interruption}", soft_wrap=True)
            raise
        except ZarmError:
            if last is None or not last.done:
                raise
            return last


def _called(segments: Sequence[PlannedSegment], number: int) -> str:
    """A segment by its name or what it does."""
    if number >= len(segments):
        return f"segment {number}"
    return segments[number].name or segments[number].action


def _warn_of_edits(robot: Robot, goal_id: str) -> None:
    """Warn once if the scene is edited during an unguarded goal; and each time the goal is held, with the reason."""
    said = threading.Event()
    held = False

    def look(_: str, state: ExecutorState) -> None:
        if state.scene_changed and state.goal_id == goal_id and not said.is_set():
            said.set()
            err.print(f"zarm: {SCENE_CHANGED}", soft_wrap=True)

    def look_at_goal(_: str, goal: GoalState) -> None:
        nonlocal held
        if goal.hold is not None and not held:
            err.print(f"zarm: the robot waits: {held_by(goal.hold)}", soft_wrap=True)
        held = goal.hold is not None

    robot.connection.bus.watch(robot.connection.keys.executor_state, look)
    robot.connection.bus.watch(robot.connection.keys.goal(goal_id), look_at_goal)


def _order(give: Callable[[Robot], ExecutorState], doc: str) -> Callable[[bool, str, str | None], None]:
    def order(as_json: AsJson = False, connect: Connect = DEFAULT_ENDPOINT, name: Name = None) -> None:
        with connected(connect, name) as robot:
            _print_state(give(robot), as_json)

    order.__doc__ = doc
    return order


stop = _order(Robot.stop, "Stop the robot now; it brakes to rest.")
pause = _order(Robot.pause, "Pause the motion; `zarm resume` continues it.")
resume = _order(Robot.resume, "Continue a paused motion.")
reset = _order(Robot.reset, "Leave the fault state, once its cause is fixed.")


def cancel(
    goal_id: Annotated[str | None, typer.Argument(help="The goal (default: the active one).")] = None,
    as_json: AsJson = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Cancel a goal; the robot brakes to rest."""
    with connected(connect, name) as robot:
        _print_state(robot.cancel(goal_id), as_json)


def _print_state(state: ExecutorState, as_json: bool) -> None:
    if as_json:
        print_json(state)
        return
    goal = f", goal {state.goal_id}" if state.goal_id else ""
    out.print(f"{state.mode} ({state.strategy}{goal})" + (f": {state.problem.message}" if state.problem else ""))
    if state.scene_changed:
        out.print(SCENE_CHANGED)


def speed(
    to: Annotated[
        float | None, typer.Argument(metavar="[0.05..1]", help="Share of the planned speed (default: show it).")
    ] = None,
    as_json: AsJson = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Show or change the share of the planned speed at which the robot moves, also in motion."""
    with connected(connect, name) as robot:
        scale = robot.speed(to)
    if as_json:
        print_json(Speed(speed_scale=scale))
    else:
        out.print(share_text(scale))


def strategy(
    to: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="The strategy to switch to (default: show all).")
    ] = None,
    as_json: AsJson = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Show the control strategies of the robot, or switch to one."""
    with connected(connect, name) as robot:
        known = robot.strategy(to)
    if as_json:
        print_json(known)
        return
    rows = [
        (("* " if one.name == known.active else "  ") + one.name, "" if one.available else one.reason or "unavailable")
        for one in known.strategies
    ]
    out.print(facts(*rows))
