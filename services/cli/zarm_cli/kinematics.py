"""`zarm fk`, `zarm ik` and `zarm check`: kinematics and distances, computed by the planner."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated

import typer

from zarm.connection import ANSWER_SECONDS
from zarm_cli.client import AsJson, Connect, Name, connected, floats, joints, message
from zarm_cli.goals import Free, Group, Tip, Tolerance, ToleranceFrame, full_pose, typed_freedom
from zarm_cli.output import degrees, facts, numbers, out, pose_text, print_json
from zarm_contract.errors import PlanningFailed
from zarm_contract.messages import CheckResults, FkPoses, HoldingTorque, IkRequest
from zarm_runtime.session import DEFAULT_ENDPOINT

At = Annotated[
    str | None,
    typer.Option("--joints", metavar="A,B,C,...", help="Joint positions (rad; default: measured)."),
]


def fk(
    at: At = None,
    group: Group = None,
    tip: Annotated[str | None, typer.Option(metavar="LINK", help="Link or attached object (default: the tip).")] = None,
    as_json: AsJson = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Forward kinematics: the tip pose at these joint positions."""
    where = joints(at, "--joints")
    with connected(connect, name) as robot:
        poses = FkPoses(poses=tuple(robot.fk([where or robot.joint_state().position], group=group, tip=tip)))
    if as_json:
        print_json(poses)
    else:
        out.print(pose_text(poses.poses[0]))


def ik(
    to: Annotated[
        str,
        typer.Option(
            metavar="X,Y,Z[,QX,QY,QZ,QW]",
            help="Pose of the tip in the base frame (m). Without an orientation the tip keeps its own.",
        ),
    ],
    free: Free = None,
    tolerance: Tolerance = None,
    tolerance_frame: ToleranceFrame = None,
    tip: Tip = None,
    group: Group = None,
    near: Annotated[
        str | None,
        typer.Option(metavar="A,B,C,...", help="Joint positions to sort the solutions by (rad; default: measured)."),
    ] = None,
    max_solutions: Annotated[int, typer.Option(help="Maximum number of solutions.")] = 8,
    colliding: Annotated[bool, typer.Option("--colliding", help="Also list solutions in collision.")] = False,
    as_json: AsJson = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Inverse kinematics: joint positions for a tip pose, one solution per line."""
    pose, at = floats(to, "--to", 3, 7), joints(near, "--near")
    freedom = typed_freedom(free, tolerance, tolerance_frame, tip)
    with connected(connect, name) as robot:
        request = message(
            IkRequest,
            poses=[full_pose(robot, pose, oriented=freedom.needs_orientation, group=group)],
            **freedom.fields,
            group=group,
            near=at,
            max_solutions=max_solutions,
            collision_free=not colliding,
        )
        found = robot.request_ik(request, timeout=ANSWER_SECONDS)
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
    spheres: Annotated[
        bool, typer.Option("--spheres", help="Also list the distance of each collision sphere.")
    ] = False,
    torque: Annotated[
        bool, typer.Option("--torque", help="Also list the torques that hold the robot there, with what it carries.")
    ] = False,
    as_json: AsJson = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Collision check: the distance to the scene and of the robot to itself."""
    where = joints(at, "--joints")
    with connected(connect, name) as robot:
        (result,) = robot.check(None if where is None else [where], spheres=spheres, torque=torque)
    if as_json:
        print_json(CheckResults(results=(result,)))
        return
    out.print(
        facts(
            ("collision", "yes" if result.in_collision else "no"),
            (
                "clearance",
                f"{result.clearance * 1e3:.1f} mm" + (f" ({' - '.join(result.pair)})" if result.pair else ""),
            ),
            ("limits", "held" if result.within_limits else "violated"),
            *([] if result.spheres is None else [("spheres", f"{numbers(result.spheres)} m")]),
            *(_torque_facts(result.holding) if torque else []),
        )
    )


def _torque_facts(holding: Sequence[HoldingTorque] | None) -> Iterator[tuple[str, str]]:
    if holding is None:
        yield "torque", "unknown: the URDF does not state the inertia of each link"
        return
    for number, one in enumerate(holding, 1):
        share = "" if one.effort is None else f", {abs(one.torque) / one.effort:.0%} of {one.effort:g}"
        yield f"torque {number}", f"{one.torque:.1f} Nm{share}"
