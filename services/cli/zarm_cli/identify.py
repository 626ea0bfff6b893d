"""`zarm identify`: the friction of the joints, and the inertia of their motors."""

from __future__ import annotations

from collections.abc import Iterable

from zarm_cli.client import AsJson, Connect, Name, connected
from zarm_cli.output import out, print_json
from zarm_contract.messages import JointDynamics
from zarm_runtime.session import DEFAULT_ENDPOINT

LIMIT_FACTOR = 2.0
"""Factor from the largest difference seen to the limit."""
MIN_LIMIT = 0.5
"""Of a limit (Nm): below it, the noise of the measured efforts counts."""


def identify(as_json: AsJson = False, connect: Connect = DEFAULT_ENDPOINT, name: Name = None) -> None:
    """Identify friction and motor inertia of the joints from their motions, and limits for collision detection."""
    with connected(connect, name) as robot:
        found = robot.joint_dynamics()
    if as_json:
        print_json(found)
        return
    out.print(f"# from {found.states} joint states of motions; joints: {', '.join(found.joint_names)}", soft_wrap=True)
    out.print("execution:\n  joint_dynamics:")
    for term in ("friction", "damping", "armature"):
        out.print(f"    {term}: {_listed(getattr(found, term))}", soft_wrap=True)
    out.print(f"  external_torque_limits: {_listed(limits(found))}", soft_wrap=True)


def limits(found: JointDynamics) -> list[float]:
    """Limits (Nm, N) that no motion should reach: twice what each joint differed by, and its friction, which is greater in cold gears."""
    return [
        max(LIMIT_FACTOR * most + friction, MIN_LIMIT)
        for most, friction in zip(found.largest, found.friction, strict=True)
    ]


def _listed(values: Iterable[float]) -> str:
    return f"[{', '.join(f'{value:.3g}' for value in values)}]"
