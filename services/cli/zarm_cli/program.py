"""`zarm program`: check a program in a file, and run it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from zarm.robot import Robot
from zarm_cli.client import AsJson, Connect, Name, connected, joints
from zarm_cli.execution import demand_success, run_goal
from zarm_cli.output import facts, out, print_json
from zarm_contract.codec import decode
from zarm_contract.document import Document, read_document
from zarm_contract.errors import InvalidRequest, ZarmError, from_problem
from zarm_contract.messages import ExecuteRequest, Plan, ProgramRequest
from zarm_runtime.session import DEFAULT_ENDPOINT

app = typer.Typer(no_args_is_help=True, help="Programs: several motions, waits and changes, planned as a whole.")

File = Annotated[
    Path,
    typer.Argument(help="A YAML file with the fields of a ProgramRequest: `segments` and others.", show_default=False),
]


@app.command()
def check(
    file: File,
    start: Annotated[
        str | None, typer.Option(metavar="A,B,C,...", help="Joint positions at the start (default: measured).")
    ] = None,
    as_json: AsJson = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Plan a program and show its segments, those before one that fails too; nothing moves."""
    document, request = _read(file)
    at = joints(start, "--start")
    if at is not None:
        request = request.model_copy(update={"start": tuple(at)})
    # What is not the whole program must not be the last plan, which `zarm execute` runs.
    request = request.model_copy(update={"partial": True, "publish": False})
    with connected(connect, name) as robot:
        plan = _planned(robot, document, request)
    if as_json:
        print_json(plan)
        _demand_whole(document, plan)
        return
    out.print(
        facts(
            ("plan", plan.plan_id),
            ("found in", f"{plan.timings.total * 1e3:.1f} ms"),
            ("motion", f"{plan.trajectory.duration:.2f} s, {plan.path_length:.2f} rad"),
            ("clearance", f"{plan.clearance * 1e3:.1f} mm at the closest, in scene revision {plan.scene_revision}"),
        )
    )
    out.print(_segments(plan))
    _demand_whole(document, plan)


@app.command()
def run(file: File, as_json: AsJson = False, connect: Connect = DEFAULT_ENDPOINT, name: Name = None) -> None:
    """Plan a program from where the robot is, and run it as one goal. Ctrl-C stops the robot."""
    document, request = _read(file)
    with connected(connect, name) as robot:
        plan = _planned(robot, document, request)
        last = run_goal(robot, ExecuteRequest(plan_id=plan.plan_id), segments=plan.segments)
    if as_json:
        print_json(last)
    demand_success(last)
    if not as_json:
        out.print(f"{last.status} after {last.elapsed:.2f} s in motion (goal {last.goal_id})")


def _read(file: Path) -> tuple[Document, ProgramRequest]:
    """Raises InvalidRequest with the file and the line."""
    document = read_document(file, "a program")
    try:
        return document, decode(ProgramRequest, json.dumps(document.data).encode())
    except InvalidRequest as error:
        raise _placed(document, error) from error


def _planned(robot: Robot, document: Document, request: ProgramRequest) -> Plan:
    try:
        return robot.request_program(request)
    except ZarmError as error:
        raise _placed(document, error) from error


def _demand_whole(document: Document, plan: Plan) -> None:
    """Raise the problem of the segment that fails, if one does."""
    if plan.problem is not None:
        raise _placed(document, from_problem(plan.problem))


def _placed(document: Document, error: ZarmError) -> ZarmError:
    """The error with the line of the field that it names."""
    problem = error.problem
    if problem.field is None:
        return error
    return from_problem(problem.model_copy(update={"message": f"{document.place(problem.field)}: {problem.message}"}))


def _segments(plan: Plan) -> Table:
    table = Table("segment", "action", "name", "begins at", "ends at", box=None)
    for number, segment in enumerate(plan.segments):
        table.add_row(str(number), segment.action, segment.name or "", f"{segment.begin:.2f} s", f"{segment.end:.2f} s")
    return table
