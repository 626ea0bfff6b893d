"""`zarm identify`: the friction of the joints."""

from __future__ import annotations

from collections.abc import Iterable

from zarm_cli.client import AsJson, Connect, Name, connected
from zarm_cli.output import out, print_json
from zarm_runtime.session import DEFAULT_ENDPOINT

SPARE = 1.5
"""Factor from the largest difference seen to the limit: warm gears have less friction than cold ones."""

LEAST = 0.1
"""Of a limit (Nm), for a joint that has not moved."""


def identify(as_json: AsJson = False, connect: Connect = DEFAULT_ENDPOINT, name: Name = None) -> None:
    """Identify the friction of the joints from their motions, and limits to detect collisions by, for the descriptor."""
    with connected(connect, name) as robot:
        found = robot.friction()
    if as_json:
        print_json(found)
        return
    out.print(f"# from {found.states} joint states of motions; joints: {', '.join(found.joint_names)}", soft_wrap=True)
    out.print("execution:\n  friction:")
    out.print(f"    dry: {_listed(found.dry)}", soft_wrap=True)
    out.print(f"    viscous: {_listed(found.viscous)}", soft_wrap=True)
    out.print(
        f"  external_torque_limits: {_listed(max(SPARE * most, LEAST) for most in found.largest)}", soft_wrap=True
    )


def _listed(values: Iterable[float]) -> str:
    return f"[{', '.join(f'{value:.3g}' for value in values)}]"
