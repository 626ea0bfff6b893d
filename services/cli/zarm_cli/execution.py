"""`zarm execute` and the commands that stop, hold and free the robot."""

from __future__ import annotations

import math
import secrets
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated

import typer

from zarm_cli.client import AsJson, Client, Connect, Name, connected, message
from zarm_cli.interrupts import Inbox, insist, wait_for
from zarm_cli.output import SCENE_CHANGED, err, facts, out, print_json
from zarm_cli.planning import JointsGoal, To, VelocityScale, read_plan, request_plan, typed_goal
from zarm_contract.errors import Unavailable, from_problem
from zarm_contract.messages import (
    Accepted,
    CancelRequest,
    ExecuteRequest,
    ExecutorState,
    GoalState,
    Speed,
    SpeedRequest,
    Strategies,
    StrategyRequest,
)
from zarm_runtime.session import DEFAULT_ENDPOINT

_LOOK_SECONDS = 0.5
_RESTART_SECONDS = 10.0  # within which an executor, started anew or heard again, tells what became of a goal
_STOP_SECONDS = 30.0


def execute(
    to: To = None,
    joints_goal: JointsGoal = None,
    plan: Annotated[Path | None, typer.Option(help="A plan saved by `zarm plan --save`.")] = None,
    plan_id: Annotated[str | None, typer.Option(help="A plan that was published on this bus.")] = None,
    velocity_scale: VelocityScale = None,
    preempt: Annotated[
        bool, typer.Option("--preempt", help="Cancel a goal that runs, and start when the robot rests.")
    ] = False,
    as_json: AsJson = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Move the robot along the last plan, a given one, or one made now (--to, --joints). Ctrl-C stops the robot."""
    goal = None if not to and joints_goal is None else typed_goal(to, joints_goal)
    if [plan, plan_id, goal].count(None) < 2:
        raise typer.BadParameter("give one of them at most", param_hint="--plan / --plan-id / --to / --joints")
    if velocity_scale is not None and goal is None:
        raise typer.BadParameter("belongs to --to or --joints", param_hint="--velocity-scale")
    request = message(ExecuteRequest, plan_id=plan_id) if plan is None else _saved(plan)
    with connected(connect, name) as client:
        if goal is not None:
            if preempt:
                _bring_to_rest(client)
            request = ExecuteRequest(plan_id=request_plan(client, goal, velocity_scale=velocity_scale).plan_id)
        last = run_goal(client, request.model_copy(update={"preempt": preempt}))
    if as_json:
        print_json(last)
    demand_success(last)
    if not as_json:
        out.print(f"{last.status} after {last.elapsed:.2f} s in motion (goal {last.goal_id})")


def _saved(file: Path) -> ExecuteRequest:
    """The request to move along a saved plan. It carries the motion itself: no service need remember that plan."""
    plan = read_plan(file)
    return ExecuteRequest(trajectory=plan.trajectory, scene_revision=plan.scene_revision)


def _bring_to_rest(client: Client) -> None:
    """Cancel the goal that runs, if any, and wait for its end: a motion is planned from where the robot rests."""
    goal_id = client.ask(client.keys.cancel, ExecutorState).goal_id
    if goal_id is not None:
        _Goal(client, goal_id).follow(lambda _: None, _STOP_SECONDS)


def demand_success(last: GoalState) -> None:
    """Raise the problem of a goal that did not succeed."""
    if last.problem is not None:
        raise from_problem(last.problem)


def run_goal(client: Client, request: ExecuteRequest) -> GoalState:
    """Execute with a progress bar and return the goal's last state; Ctrl-C cancels and waits until the robot stands."""
    goal_id = f"cli-{secrets.token_hex(8)}"
    named = request.model_copy(update={"goal_id": goal_id})
    try:  # Ctrl-C waits until it is known what there is to cancel, or that is withdrawn
        with insist(_telling(client, "to take the goal or refuse it")):
            client.ask(client.keys.execute, Accepted, named, timeout=_STOP_SECONDS)
    except (Unavailable, KeyboardInterrupt):  # the executor may have got the request, and start yet
        with _until_left(client, "to withdraw the goal"):
            _cancel(client, goal_id)
        raise
    _warn_of_edits(client, goal_id)
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn  # a stop does without

    goal = _Goal(client, goal_id)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(None),
        TaskProgressColumn(),
        TextColumn("{task.fields[time]}"),
    )
    with Progress(*columns, console=err, transient=True, disable=not err.is_terminal) as bar:
        task = bar.add_task("accepted", total=1.0, time="")

        def show(state: GoalState) -> None:
            bar.update(
                task,
                description=state.status,
                completed=state.progress,
                time=f"{state.elapsed:.1f} of {state.duration:.1f} s",
            )

        try:
            return goal.follow(show)
        except KeyboardInterrupt:
            with _until_left(client, "to bring the robot to rest"):
                _cancel(client, goal_id)
                last = goal.follow(show, _STOP_SECONDS)
            err.print(f"zarm: {last.status}: the robot stands still at {last.progress:.0%} of the motion")
            raise


def _warn_of_edits(client: Client, goal_id: str) -> None:
    """Say it, once, when the scene becomes another than the one that the goal was begun in."""
    said = threading.Event()

    def look(_: str, state: ExecutorState) -> None:
        if state.scene_changed and state.goal_id == goal_id and not said.is_set():
            said.set()
            err.print(f"zarm: {SCENE_CHANGED}", soft_wrap=True)

    client.bus.watch(client.keys.executor_state, ExecutorState, look)


def _cancel(client: Client, goal_id: str) -> None:
    with suppress(Unavailable):
        client.ask(client.keys.cancel, ExecutorState, CancelRequest(goal_id=goal_id))


@contextmanager
def _until_left(client: Client, awaited: str) -> Iterator[None]:
    """`insist`, and where it is in vain say what that means."""
    try:
        with insist(_telling(client, awaited)):
            yield
    except KeyboardInterrupt:
        err.print(
            f"zarm: interrupted: the executor of {client.keys.robot} has not answered, and the state of the robot is unknown: "
            "make sure that it stands still, then see `zarm status`",
            soft_wrap=True,
        )
        raise


def _telling(client: Client, awaited: str) -> Callable[[], None]:
    return lambda: err.print(
        f"zarm: waiting for the executor of {client.keys.robot} {awaited}; Ctrl-C again leaves the robot as it is",
        soft_wrap=True,
    )


class _Goal:
    """The states of one goal: as they are told, and where none is told for a while, as the executor answers."""

    def __init__(self, client: Client, goal_id: str) -> None:
        self._client = client
        self._key = client.keys.goal(goal_id)
        self._id = goal_id
        self._states: Inbox[GoalState] = Inbox()
        client.bus.watch(self._key, GoalState, lambda _, state: self._states.put(state))

    def follow(self, show: Callable[[GoalState], None], timeout: float = math.inf) -> GoalState:
        """The last state. Raises Unavailable where it is not there `timeout` s from now, or nothing is heard of the goal."""
        end = time.monotonic() + timeout
        silent = time.monotonic() + _RESTART_SECONDS
        while True:
            if (state := self._next()) is not None:
                silent = time.monotonic() + _RESTART_SECONDS
                show(state)
                if state.done:
                    return state
            if time.monotonic() > min(end, silent):
                raise Unavailable(
                    f"the end of the goal {self._id} is unknown: its executor does not answer; make sure that the "
                    "robot stands still, then see `zarm status`"
                )

    def _next(self) -> GoalState | None:
        if (state := wait_for(self._states, _LOOK_SECONDS)) is not None:
            return state
        with suppress(Unavailable):  # held, or told while the way here was cut
            return self._client.ask(self._key, GoalState, timeout=_LOOK_SECONDS)
        return None


def _order(key: Callable[[Client], str], doc: str) -> Callable[[bool, str, str | None], None]:
    def order(as_json: AsJson = False, connect: Connect = DEFAULT_ENDPOINT, name: Name = None) -> None:
        with connected(connect, name) as client:
            _print_state(client.ask(key(client), ExecutorState), as_json)

    order.__doc__ = doc
    return order


stop = _order(lambda client: client.keys.stop, "Stop the robot now; it decelerates to rest.")
pause = _order(lambda client: client.keys.pause, "Hold the motion; `zarm resume` goes on with it.")
resume = _order(lambda client: client.keys.resume, "Go on with a motion that was paused.")
reset = _order(lambda client: client.keys.reset, "Leave the fault state, once its reason is mended.")


def cancel(
    goal_id: Annotated[str | None, typer.Argument(help="Left out: the goal that runs.")] = None,
    as_json: AsJson = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Cancel a goal; the robot decelerates to rest."""
    with connected(connect, name) as client:
        _print_state(client.ask(client.keys.cancel, ExecutorState, message(CancelRequest, goal_id=goal_id)), as_json)


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
        float | None, typer.Argument(metavar="[0.05..1]", help="The share of the planned speed; left out: show it.")
    ] = None,
    as_json: AsJson = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Show at which share of the planned speed the robot moves, or change it, also while it moves."""
    with connected(connect, name) as client:
        if to is None:
            known = client.read(client.keys.speed, Speed)
        else:
            known = client.ask(client.keys.speed, Speed, message(SpeedRequest, speed_scale=to))
    if as_json:
        print_json(known)
    else:
        out.print(f"{known.speed_scale:g} of the planned speed")


def strategy(
    to: Annotated[str | None, typer.Argument(metavar="[NAME]", help="Switch to it; left out: show them.")] = None,
    as_json: AsJson = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Show the control strategies of the robot, or switch to one."""
    with connected(connect, name) as client:
        if to is None:
            known = client.read(client.keys.strategy, Strategies)
        else:
            request = message(StrategyRequest, strategy=to)
            known = client.ask(client.keys.strategy, Strategies, request, timeout=_STOP_SECONDS)
    if as_json:
        print_json(known)
        return
    rows = [
        (("* " if one.name == known.active else "  ") + one.name, "" if one.available else one.reason or "unavailable")
        for one in known.strategies
    ]
    out.print(facts(*rows))
