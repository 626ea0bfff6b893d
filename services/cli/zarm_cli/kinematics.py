"""`zarm fk`, `zarm ik` and `zarm check`: kinematics and distances, computed by the planner."""

from __future__ import annotations

from typing import Annotated

import typer

from zarm_cli.client import AsJson, Connect, Name, connected, floats, joints, message
from zarm_cli.output import degrees, facts, numbers, out, pose_text, print_json
from zarm_cli.planning import full_pose
from zarm_contract.errors import PlanningFailed
from zarm_contract.messages import CheckRequest, CheckResults, FkPoses, FkRequest, IkRequest, IkSolutions
from zarm_runtime.session import DEFAULT_ENDPOINT

At = Annotated[
    str | None,
    typer.Option("--joints", metavar="A,B,C,...", help="Joint positions (rad); left out: the measured ones."),
]


def fk(at: At = None, as_json: AsJson = False, connect: Connect = DEFAULT_ENDPOINT, name: Name = None) -> None:
    """Where the tip is at these joint positions."""
    where = joints(at, "--joints")
    with connected(connect, name) as client:
        request = message(FkRequest, joints=[where or client.measured().position])
        poses = client.ask(client.keys.fk, FkPoses, request)
    if as_json:
        print_json(poses)
    else:
        out.print(pose_text(poses.poses[0]))


def ik(
    to: Annotated[
        str,
        typer.Option(
            metavar="X,Y,Z[,QX,QY,QZ,QW]",
            help="Pose of the tip in the base frame (m); without an orientation the tip keeps the one it has.",
        ),
    ],
    near: Annotated[
        str | None, typer.Option(metavar="A,B,C,...", help="Solutions near these joints first; left out: the measured.")
    ] = None,
    max_solutions: Annotated[int, typer.Option(help="How many at most.")] = 8,
    colliding: Annotated[bool, typer.Option("--colliding", help="Solutions that collide as well.")] = False,
    as_json: AsJson = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Joint positions that bring the tip to a pose, one solution a line."""
    pose, at = floats(to, "--to", 3, 7), joints(near, "--near")
    with connected(connect, name) as client:
        request = message(
            IkRequest,
            poses=[full_pose(client, pose)],
            near=at,
            max_solutions=max_solutions,
            collision_free=not colliding,
        )
        found = client.ask(client.keys.ik, IkSolutions, request)
    if as_json:
        print_json(found)
    if not found.solutions[0]:
        raise PlanningFailed(
            "no joint solution reaches this pose" + ("" if colliding else " without a collision; see --colliding"),
            code="unreachable",
        )
    if not as_json:
        for solution in found.solutions[0]:
            out.print(f"{numbers(solution, 4)}   ({degrees(solution)} deg)")


def check(
    at: At = None,
    spheres: Annotated[bool, typer.Option("--spheres", help="The distance of each collision sphere as well.")] = False,
    as_json: AsJson = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """How close the robot comes to the scene and to itself at these joint positions."""
    where = joints(at, "--joints")
    with connected(connect, name) as client:
        request = message(CheckRequest, joints=None if where is None else [where], spheres=spheres)
        results = client.ask(client.keys.check, CheckResults, request)
    if as_json:
        print_json(results)
        return
    result = results.results[0]
    out.print(
        facts(
            ("collision", "yes" if result.in_collision else "no"),
            (
                "clearance",
                f"{result.clearance * 1e3:.1f} mm" + (f" ({' - '.join(result.pair)})" if result.pair else ""),
            ),
            ("limits", "held" if result.within_limits else "violated"),
            *([] if result.spheres is None else [("spheres", f"{numbers(result.spheres)} m")]),
        )
    )
