"""`zarm jog` and `zarm track`: the robot follows keys or a target, and keeps clear of obstacles."""

from __future__ import annotations

import os
import select
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import typer
from rich.table import Table

from zarm.robot import Robot
from zarm.servoing import PERIOD, Jogging, limited
from zarm_cli.client import SIGNALS, AsJson, Connect, Name, connected, message
from zarm_cli.goals import (
    Free,
    Freedom,
    Group,
    JointsGoal,
    To,
    Tolerance,
    ToleranceFrame,
    full_pose,
    typed_freedom,
    typed_goal,
)
from zarm_cli.output import err, facts, out, print_json
from zarm_cli.planning import VelocityScale
from zarm_contract.messages import PoseGoal, ServoSession
from zarm_runtime.session import DEFAULT_ENDPOINT

HOLD = 0.6
"""How long (s) a key press counts: at least until a terminal repeats it."""
LINEAR, ANGULAR, JOINT = 0.1, 0.5, 0.3
"""Speeds (m/s, rad/s, rad/s) at the scale 1."""
SETTLED = 0.3
"""A limit is shown once it has lasted this long (s): between two obstacles, or at the margin, it changes many times a second."""
_SLOWEST, _FASTEST, _FACTOR = 0.05, 2.0, 1.25
_AXES = {
    "w": (0, 1), "s": (0, -1), "a": (1, 1), "d": (1, -1), "r": (2, 1), "f": (2, -1),
    "u": (3, 1), "o": (3, -1), "i": (4, 1), "k": (4, -1), "j": (5, 1), "l": (5, -1),
}  # fmt: skip
"""The twist component of each key, and its sign."""
_HELP = """\
w s   x + -     u o   about x + -    1..9  choose a joint    + -    faster, slower
a d   y + -     i k   about y + -    ] [   move it + -       t      base or tool
r f   z + -     j l   about z + -    space  stop             q      end"""

Margin = Annotated[float, typer.Option(help="Distance to keep from obstacles (m).")]
TakeOver = Annotated[bool, typer.Option("--take-over", help="Take over from another client's session.")]


@dataclass(frozen=True)
class Keys:
    """The motion that the pressed keys request: a twist or the speed of one joint, `pressed` at that moment (s,
    monotonic).
    """

    scale: float = 0.5
    frame: Literal["base", "tool"] = "base"
    joint: int = 0
    moves: tuple[Literal["axis", "joint"], int, int] | None = None
    pressed: float = 0.0

    def press(self, key: str, joints: int, now: float) -> Keys:
        """The state after one more key; an unknown key stops, as space does."""
        match key:
            case "+" | "=":
                return replace(self, scale=min(_FASTEST, self.scale * _FACTOR))
            case "-":
                return replace(self, scale=max(_SLOWEST, self.scale / _FACTOR))
            case "t":
                return replace(self, frame="tool" if self.frame == "base" else "base", moves=None)
            case "]" | "[":
                return replace(self, moves=("joint", self.joint, 1 if key == "]" else -1), pressed=now)
            case _ if key in _AXES:
                axis, sign = _AXES[key]
                return replace(self, moves=("axis", axis, sign), pressed=now)
            case _ if key.isdecimal() and 1 <= int(key) <= joints:
                return replace(self, joint=int(key) - 1, moves=None)
        return replace(self, moves=None)

    def send(self, jogging: Jogging, joints: int, group: str | None, now: float) -> None:
        """Send the present request to the robot; a twist is that of the tip of the `group`."""
        moves = self.moves if now - self.pressed <= HOLD else None
        values = [0.0] * max(6, joints)
        if moves is not None and moves[0] == "joint":
            values[moves[1]] = moves[2] * JOINT * self.scale
            jogging.joint_speed(values[:joints])
            return
        if moves is not None:
            values[moves[1]] = moves[2] * self.scale * (LINEAR if moves[1] < 3 else ANGULAR)
        jogging.twist(values[:3], values[3:6], frame=self.frame, group=group)


class Shown:
    """Debounces the states of a session: a new one is shown when others have lasted `SETTLED` s longer than twice the shown one."""

    def __init__(self) -> None:
        self._what, self._others = "", 0.0
        self._before: tuple[str, float] | None = None

    def changes(self, what: str, now: float) -> bool:
        """Whether to show what limits the session from the moment `now` (s, monotonic) on."""
        if self._before is not None:
            before, since = self._before
            lasted = now - since
            self._others = max(0.0, self._others - 2 * lasted) if before == self._what else self._others + lasted
        self._before = what, now
        if what == self._what or self._others < SETTLED:
            return False
        self._what, self._others = what, 0.0
        return True


def jog(
    group: Group = None,
    margin: Margin = 0.01,
    velocity_scale: VelocityScale = None,
    take_over: TakeOver = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Jog the robot with keys. It slows down near obstacles, slides along them, and stops when you release the keys."""
    from rich.live import Live

    if not sys.stdin.isatty():
        raise typer.BadParameter("jogging reads keys from a terminal; run it in one", param_hint="standard input")
    with connected(connect, name) as robot:
        joints, keys = len(robot.joint_state().position), Keys()
        scale = 1.0 if velocity_scale is None else velocity_scale
        with (
            robot.jog(margin=margin, velocity_scale=scale, take_over=take_over) as jogging,
            _single_keys() as descriptor,
            Live(console=out, auto_refresh=False, transient=True) as live,
        ):
            shown = 0.0
            while jogging.running:
                SIGNALS.check()
                for key in _read(descriptor):
                    if key in ("q", "\x04"):
                        return
                    keys = keys.press(key, joints, time.monotonic())
                now = time.monotonic()
                keys.send(jogging, joints, group, now)
                if now - shown > 0.1:
                    shown = now
                    live.update(_display(keys, jogging.state), refresh=True)
            jogging.end()  # raises the reason for its end


def track(
    to: To = None,
    free: Free = None,
    tolerance: Tolerance = None,
    tolerance_frame: ToleranceFrame = None,
    joints_goal: JointsGoal = None,
    group: Group = None,
    timeout: Annotated[float, typer.Option(help="Give up after this time (s).")] = 30.0,
    margin: Margin = 0.01,
    velocity_scale: VelocityScale = None,
    take_over: TakeOver = False,
    as_json: AsJson = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Move the robot straight to a pose or joint positions, or along a global plan around obstacles."""
    freedom = typed_freedom(free, tolerance, tolerance_frame, None)
    typed = typed_goal(to, joints_goal, False, freedom)
    if len(typed.poses) > 1 or typed.groups:
        raise typer.BadParameter("give one pose", param_hint="--to")
    with connected(connect, name) as robot:
        goal = typed.joints if typed.joints is not None else _target(robot, typed.poses[0], freedom, group)
        scale = 1.0 if velocity_scale is None else velocity_scale
        shown = Shown()
        with robot.track(margin=margin, velocity_scale=scale, take_over=take_over) as tracking:

            def show(state: ServoSession) -> None:
                if shown.changes(limited(state).partition(",")[0], time.monotonic()):
                    err.print(f"zarm: {limited(state)}", soft_wrap=True)

            tracking.reach(goal, timeout=timeout, group=group, on_progress=show)
            last = tracking.state
    if last is None:
        return
    if as_json:
        print_json(last)
    elif last.joint_error is not None:
        out.print(f"reached to {last.joint_error:.4f} rad")
    else:
        out.print(f"reached to {1e3 * (last.position_error or 0.0):.2f} mm and {last.orientation_error or 0.0:.4f} rad")


def _target(robot: Robot, values: list[float], freedom: Freedom, group: str | None) -> PoseGoal:
    pose = full_pose(robot, values, oriented=freedom.needs_orientation, group=group)
    return message(PoseGoal, kind="pose", **pose, **freedom.fields)


def _display(keys: Keys, state: ServoSession | None) -> Table:
    clearance = "more than 150 mm" if state is None or state.clearance is None else f"{1e3 * state.clearance:.0f} mm"
    table = facts(
        ("limited", limited(state)),
        ("clearance", clearance),
        ("speed", f"{keys.scale:.2f} of {LINEAR:g} m/s, {ANGULAR:g} rad/s; joint {JOINT:g} rad/s"),
        ("frame", f"{keys.frame}; joint {keys.joint + 1}"),
    )
    if state is not None and state.refused is not None:
        table.add_row("refused", state.refused.message)
    table.add_row("keys", _HELP)
    return table


@contextmanager
def _single_keys() -> Iterator[int]:
    """The terminal delivers each key at once, without echo; Ctrl-C keeps its meaning."""
    import termios
    import tty

    descriptor = sys.stdin.fileno()
    before = termios.tcgetattr(descriptor)
    tty.setcbreak(descriptor)
    try:
        yield descriptor
    finally:
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)


def _read(descriptor: int) -> str:
    """The keys pressed, after at most `PERIOD` s; the end of the input counts as Ctrl-D, and anything undecodable
    stops.
    """
    if not select.select([descriptor], [], [], PERIOD)[0]:
        return ""
    read = os.read(descriptor, 64).decode(errors="replace") or "\x04"
    return " " if "\x1b" in read else read  # an arrow, a function key
