"""`zarm status`, `zarm health` and `zarm watch`: which services run, and what the robot does."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from zarm.robot import Robot
from zarm_cli.client import AsJson, Connect, Name, connected
from zarm_cli.compatibility import mismatches
from zarm_cli.digital_outputs import level
from zarm_cli.interrupts import pause
from zarm_cli.output import (
    SCENE_CHANGED,
    counted,
    degrees,
    err,
    facts,
    held_by,
    out,
    pose_text,
    print_json,
    reached,
    records,
    share_text,
)
from zarm_contract.codec import CONTRACT
from zarm_contract.errors import InternalError, Unavailable
from zarm_contract.messages import (
    CollisionDetectionState,
    ExecutorState,
    GoalState,
    GripperState,
    Health,
    JointState,
    Message,
    OutputState,
    Pose,
    Scene,
    ServoState,
)
from zarm_runtime.session import DEFAULT_ENDPOINT
from zarm_runtime.version import version

if TYPE_CHECKING:
    from rich.table import Table

_NEEDED = ("planner", "executor")
_PERIOD = 0.1  # interval (s) of `watch`
_STALE = 1.0  # s after which a joint state is no longer shown

_DETECTION: Mapping[CollisionDetectionState, str] = {
    "on": "felt by the efforts of the joints",
    "no_inertia": "not felt: the URDF does not state the inertia of each link",
    "no_effort": "not felt: the driver reports no efforts",
}

M = TypeVar("M", bound=Message)


def status(as_json: AsJson = False, connect: Connect = DEFAULT_ENDPOINT, name: Name = None) -> int:
    """Show the services of a robot, whether they are compatible, its state and its scene.

    Exit code 3 unless planner and executor are ready; 1 if services have different contracts or different files
    of the robot.
    """
    with connected(connect, name) as robot:
        bus, keys = robot.connection.bus, robot.connection.keys
        found = {service for _, service, _ in bus.alive(keys.alive("*", "*"))}
        services = {one: _answered(partial(robot.health, one)) for one in sorted(found | {*_NEEDED})}
        state, scene = _answered(robot.state), _answered(robot.scene.read)
        servo = _answered(partial(bus.read, keys.servo_state, timeout=1.0)) if "servo" in found else None
        grippers, outputs = robot.gripper.all(), robot.outputs.all()
        goal_id = None if state is None else state.goal_id
        goal = None if goal_id is None else _answered(partial(bus.read, keys.goal(goal_id), timeout=1.0))
    faults = list(mismatches({one: health for one, health in services.items() if health is not None}))
    if as_json:
        print_json(
            {
                "robot": robot.name,
                "client": {"version": version(), "contract": CONTRACT},
                "services": services,
                "mismatches": [vars(fault) for fault in faults],
                "executor": state,
                "goal": goal,
                "servo": servo,
                "grippers": grippers,
                "outputs": outputs,
                "scene": scene,
            }
        )
    else:
        _print_status(robot, services, state, goal, servo, scene, grippers, outputs)
        for fault in faults:
            out.print(f"\n{fault.kind}: {fault.message}.", style="yellow" if fault.harmless else "bold red")
    if missing := [one for one in _NEEDED if (health := services[one]) is None or not health.ready]:
        raise Unavailable(" and ".join(_not_ready(one, services[one]) for one in missing))
    if serious := [fault.message for fault in faults if not fault.harmless]:
        err.print(f"zarm: mismatch: {'. '.join(serious)}", soft_wrap=True)
        return 1
    return 0


def _not_ready(service: str, health: Health | None) -> str:
    return f"{service} not ready" + ("" if health is None else f" ({health.activity})")


def _answered(ask: Callable[[], M]) -> M | None:
    try:
        return ask()
    except (Unavailable, InternalError):  # no answer, or one with another contract
        return None


def _print_status(
    robot: Robot,
    services: Mapping[str, Health | None],
    state: ExecutorState | None,
    goal: GoalState | None,
    servo: ServoState | None,
    scene: Scene | None,
    grippers: Mapping[str, GripperState],
    outputs: Mapping[str, OutputState],
) -> None:
    columns = ("service", "state", "uptime (s)", "pid", "instance", "version", "contract", "robot")
    rows = [("robot", f"{robot.name} at {robot.connection.bus.endpoint}")]
    if state is not None:
        rows += _state_rows(state)
    if goal is not None:
        rows += _hold_rows(goal)
    if servo is not None and servo.collision_detection != "off":
        rows.append(("collisions", _DETECTION[servo.collision_detection]))
    for gripper in grippers.values():
        width = "opening unknown" if gripper.width is None else f"open {gripper.width:.3f} m"
        rows.append((gripper.gripper, f"{width}, {gripper.status}"))
    rows += [(output.output, level(output)) for output in outputs.values()]
    if scene is not None:
        rows.append(("scene", f"{counted(len(scene.objects), 'object')}, revision {scene.revision}"))
    rows += [(service, health.note) for service, health in services.items() if health is not None and health.note]
    table = records(columns, [_service_row(service, health) for service, health in services.items()])
    out.print(facts(*rows), "", table, sep="\n")


def _service_row(service: str, health: Health | None) -> tuple[str, ...]:
    if health is None:
        return service, "does not answer"
    activity = "ready" if health.ready else health.activity
    whence = (str(health.pid), health.instance, health.version, health.contract, health.robot_hash)
    return service, activity, f"{health.uptime:.0f}", *whence


def _state_rows(state: ExecutorState) -> list[tuple[str, str]]:
    rows = [("mode", state.mode + (f", goal {state.goal_id}" if state.goal_id else "")), ("strategy", state.strategy)]
    if state.speed_scale != 1.0:
        rows.append(("speed", share_text(state.speed_scale)))
    if state.goal_id is not None or state.guarded:
        rows.append(("guard", "guarded by the servo" if state.guarded else "unguarded: no servo watches this motion"))
    if state.scene_changed:
        rows.append(("warning", SCENE_CHANGED))
    if state.problem is not None:
        rows.append(("problem", f"{state.problem.code}: {state.problem.message}"))
    return rows


def _hold_rows(goal: GoalState) -> list[tuple[str, str]]:
    return [] if goal.hold is None else [("held", held_by(goal.hold))]


def health(
    service: Annotated[str, typer.Argument(help="planner, executor, ...")],
    as_json: AsJson = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Exit with 0 when the service is ready, with 3 when it is not."""
    with connected(connect, name) as robot:
        found = robot.health(service)
    if as_json:
        print_json(found)
    if not found.ready:
        raise Unavailable(f"the {service} of {robot.name} is not ready yet: {found.activity}")
    if not as_json:
        out.print(f"the {service} of {robot.name} is ready")


def watch(as_json: AsJson = False, connect: Connect = DEFAULT_ENDPOINT, name: Name = None) -> None:
    """Show the robot's state live, until Ctrl-C. With --json: ten lines a second."""
    with connected(connect, name) as robot:
        looks = _looks(robot)
        if as_json:
            for look in looks:
                print_json(vars(look))
            return
        from rich.live import Live  # no other command needs it

        with Live(console=out, auto_refresh=False) as live:
            for look in looks:
                live.update(_picture(robot, look), refresh=True)


@dataclass(frozen=True)
class _Look:
    state: ExecutorState | None
    goal: GoalState | None
    joints: JointState | None
    tip: Pose | None


def _looks(robot: Robot) -> Iterator[_Look]:
    bus, keys = robot.connection.bus, robot.connection.keys
    states: dict[str, ExecutorState] = {}
    goals: dict[str, GoalState] = {}

    def keep_goal(_: str, goal: GoalState) -> None:
        goals[goal.goal_id] = goal
        if len(goals) > 100:
            del goals[next(iter(goals))]

    bus.watch(keys.executor_state, states.__setitem__)
    bus.watch(keys.goal("*"), keep_goal)
    newest = bus.latest(keys.joint_states)
    while True:
        state = states.get(keys.executor_state)
        joints = newest.get(max_age=_STALE)
        yield _Look(
            state,
            goals.get(state.goal_id) if state is not None and state.goal_id is not None else None,
            joints,
            None if joints is None else _tip(robot, joints),
        )
        pause(_PERIOD)


def _tip(robot: Robot, joints: JointState) -> Pose | None:
    try:
        return robot.fk([joints.position], timeout=_STALE)[0]
    except Unavailable:
        return None


def _picture(robot: Robot, look: _Look) -> Table:
    state, goal, joints, tip = look.state, look.goal, look.joints, look.tip
    rows = [("robot", robot.name)]
    rows += [("mode", "the executor does not answer")] if state is None else _state_rows(state)
    if goal is not None:
        filled = round(goal.progress * 30)
        rows += _hold_rows(goal)
        rows.append(("goal", f"{'━' * filled}{'╌' * (30 - filled)} {reached(goal)}"))
    rows.append(("tip", "unknown" if tip is None else pose_text(tip)))
    if joints is None:
        rows.append(("joints", f"no state for {_STALE:g} s"))
    else:
        columns = zip(joints.joint_names, joints.position, joints.velocity, strict=True)
        rows += [(joint, f"{q:8.4f} rad {degrees((q,)):>7} deg {qd:8.4f} rad/s") for joint, q, qd in columns]
    return facts(*rows)
