"""`zarm up`: starts and stops the router, planner, servo and executor of one robot together."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import dataclass
from enum import StrEnum
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from zarm.connection import Connection
from zarm.robot import Robot
from zarm_cli.client import SIGNALS, keys_of
from zarm_cli.imported import descriptor_of
from zarm_cli.interrupts import pause
from zarm_cli.output import err, facts, numbers, out
from zarm_cli.supervision import Supervisor
from zarm_cli.view import VIEW, VIEWER, require_viewer
from zarm_contract.errors import InternalError, InvalidRequest, Unavailable
from zarm_contract.keys import Keys
from zarm_contract.messages import Health
from zarm_contract.robot import RobotDescription, find_robot, load_robot
from zarm_runtime.bus import Bus
from zarm_runtime.clock import MAX_SPEED
from zarm_runtime.dds import RANGE, REACH
from zarm_runtime.service import default_state
from zarm_runtime.session import DEFAULT_ENDPOINT, open_router, resolved_endpoint

SERVICES = ("planner", "servo", "executor")
"""The services that every robot needs, in start order; they stop in reverse, so that the robot comes to rest first."""
METERED = ("planner", "executor", "ros_bridge", "leeloo_sim", "servo", "physics_sim", "perception")
"""Services whose metrics are served: the first at the address given to `up`, the others at the following ports."""
_PLANNER_PACKAGES = ("fcl", "llvmlite", "numba", "trimesh")
_ROS_PACKAGES = ("rclpy", "curobo_msgs")


class SimulatedDriver(StrEnum):
    """The driver used by strategies that need one, if `zarm up` starts it."""

    sim = "sim"
    physics = "physics"

    @property
    def service(self) -> str:
        """The service that it is."""
        return "leeloo_sim" if self is SimulatedDriver.sim else "physics_sim"


@dataclass(frozen=True)
class Stack:
    """What `launch` has started."""

    robot: RobotDescription
    client: Robot
    supervisor: Supervisor
    services: Sequence[str]

    def health(self, service: str) -> Health | None:
        """The health of a service, None while it does not answer."""
        try:
            return self.client.health(service, timeout=1.0)
        except Unavailable:
            return None

    def wait_ready(self, report: Callable[[str], None]) -> None:
        """Wait until every service is ready, reporting what they do. Raises Unavailable if one cannot start."""
        while not_ready := [
            (name, health) for name in self.services if not ((health := self.health(name)) and health.ready)
        ]:
            report(", ".join(f"{name}: {health.activity if health else 'starting'}" for name, health in not_ready))
            if fallen := self.supervisor.fallen():
                raise Unavailable(f"the {fallen[0]} cannot start: {self.supervisor.last_words(fallen[0])}")
            pause(0.1)

    def wait(self) -> None:
        """Wait for ever, logging restarts; raises InternalError when a service keeps failing."""
        # A robot does not need the page.
        while not (fallen := [name for name in self.supervisor.given_up() if name != "viewer"]):
            for service, how in self.supervisor.ended():
                err.print(f"zarm: the {service} has ended ({how}) and is started again", soft_wrap=True)
            pause(1.0)
        raise InternalError(
            f"the {fallen[0]} keeps ending, the last time with: {self.supervisor.last_words(fallen[0])}"
        )


@contextmanager
def launch(
    robot: str,
    *,
    name: str | None = None,
    strategy: str | None = None,
    driver: SimulatedDriver | None = None,
    physics: Sequence[str] = (),
    perception: Sequence[str] | None = None,
    ros: bool = False,
    moveit: str | None = None,
    connect: str | None = None,
    listen: str = DEFAULT_ENDPOINT,
    state: Path,
    meshes: Sequence[Path] = (),
    metrics: str | None = None,
    log_level: str | None = None,
    view: str | None = None,
    speed: float = 1.0,
) -> Iterator[Stack]:
    """Start the services of one robot, with a router of their own at `listen` or using the one at `connect`; at `view`,
    `HOST:PORT`, also the page; with `moveit`, the planning group of MoveIt's clients, also the bridge.

    `physics` are arguments for the physical driver, `perception`, if it is to run, for that. All run `speed` times as fast as real time. Leaving stops them in order. Raises InvalidRequest for an invalid descriptor or name and for a robot already running
    on that bus, Unavailable if the port is taken, no router answers, or packages are missing.
    """
    _require("the planner cannot run", _PLANNER_PACKAGES, "`pip install 'zarm[planner]'` installs what is needed")
    ros = ros or moveit is not None
    if ros and speed != 1.0:
        raise InvalidRequest("ROS 2 runs in real time; leave out --ros and --moveit, or --speed", field="--speed")
    if ros:
        _require(
            "ROS 2 cannot be bridged to",
            _ROS_PACKAGES,
            "`make ros` installs what is needed, and all else works without --ros",
        )
    if view is not None:
        require_viewer()
    if driver is SimulatedDriver.physics:
        _require("physics cannot be simulated", ("mujoco",), "`pip install 'zarm[sim]'` installs it")
    robot = descriptor_of(robot)
    loaded = load_robot(robot)
    keys = keys_of(name if name is not None else loaded.descriptor.name)
    endpoint = resolved_endpoint(connect or listen)
    arguments = ["--robot", str(find_robot(robot)), "--name", keys.robot, "--connect", endpoint, "--state", str(state)]
    if driver is SimulatedDriver.physics and strategy is None and loaded.descriptor.strategy == "emulator":
        strategy = _driven_by(loaded)
    choice = [] if strategy is None else ["--strategy", strategy]
    folders = [word for folder in meshes for word in ("--meshes", str(folder))]
    simulated = {}
    if driver is not None:
        simulated[driver.service] = (f"zarm_{driver.service}.service", [*arguments, *physics])
    interfaces = [] if moveit is None else ["--moveit", "--group", moveit]
    bridge = {"ros_bridge": ("zarm_ros_bridge.service", [*arguments, *interfaces])} if ros else {}
    programs = {
        **simulated,  # this and the bridge before the executor, which may wait for a driver and at the end brakes by it
        **bridge,
        **({} if perception is None else {"perception": ("zarm_perception.service", [*arguments, *perception])}),
        "planner": ("zarm_planner.service", [*arguments, *folders]),
        "servo": ("zarm_servo.service", [*arguments, *folders]),
        "executor": ("zarm_executor.service", [*arguments, *choice]),
    }
    if metrics is not None:
        for service, (_, words) in programs.items():
            words += ["--metrics", _next_port(metrics, METERED.index(service))]
    if view is not None:
        page = ["--robot", f"{keys.robot}={find_robot(robot)}", "--connect", endpoint, "--listen", view, *folders]
        programs["viewer"] = (VIEWER, [*page, "--state", str(state)])
    environment = {"ZARM_SIM_SPEED": f"{speed:g}"}
    environment["ZARM_METRICS"] = ""  # an address can be used only once
    if ros and not any(map(os.environ.get, REACH)):
        environment[RANGE] = "LOCALHOST"  # anyone who reaches DDS can move the robot
    if sys.stderr.isatty():
        environment["ZARM_COLOUR"] = "1"
    if log_level is not None:
        environment["ZARM_LOG"] = log_level
    with ExitStack() as stack:
        if connect is None:
            stack.enter_context(_router(listen, keys))
        bus = stack.enter_context(Bus(endpoint, timeout=2.0))
        _refuse_second(bus, keys, endpoint)
        supervisor = stack.enter_context(Supervisor(programs, environment))
        yield Stack(loaded, Robot(Connection.of(bus, keys, SIGNALS)), supervisor, (*bridge, *SERVICES))


def _driven_by(robot: RobotDescription) -> str:
    """The strategy that moves a robot through its driver: whole trajectories, where the driver plays them. Raises InvalidRequest."""
    params = robot.descriptor.strategy_params
    if params is None:
        raise InvalidRequest(
            f"{robot.descriptor.name} has no strategy_params in its descriptor, so that nothing would reach the physical driver; "
            "docs/reference/robot.md explains what to write there",
            field="--driver",
        )
    return "joint_trajectory" if "joint_trajectory" in params.strategies else params.strategies[0]


def _next_port(address: str, step: int) -> str:
    host, _, port = address.rpartition(":")
    if not (host and port.isdecimal()):
        raise InvalidRequest(
            f"{address!r} is not an address for metrics; write it like 127.0.0.1:9464", field="--metrics"
        )
    return f"{host}:{int(port) + step}"


def _require(what: str, packages: Sequence[str], remedy: str) -> None:
    if missing := [package for package in packages if find_spec(package) is None]:
        raise Unavailable(f"{what}, because {' and '.join(missing)} cannot be imported here; {remedy}")


def _router(listen: str, keys: Keys) -> AbstractContextManager[object]:
    try:
        return open_router(listen)
    except Unavailable:
        with suppress(Unavailable), Bus(listen, timeout=1.0) as bus:  # is it zarm that listens there?
            _refuse_second(bus, keys, listen)
        raise


def _refuse_second(bus: Bus, keys: Keys, endpoint: str) -> None:
    if running := sorted({service for _, service, _ in bus.alive(keys.alive("*", "*"))} & {*SERVICES}):
        raise InvalidRequest(
            f"the robot {keys.robot} is already up on the bus at {endpoint} ({', '.join(running)}); `zarm status` shows "
            "it; a second robot needs another --name and --connect to that bus"
        )


def up(
    context: typer.Context,
    robot: Annotated[
        str,
        typer.Option(
            envvar="ZARM_ROBOT", help="A robot that comes with zarm, a descriptor (.yaml), or a URDF or xacro."
        ),
    ] = ("doosan_m1013"),
    name: Annotated[
        str | None,
        typer.Option(envvar="ZARM_NAME", help="Name of the robot on the bus (default: as in the descriptor)."),
    ] = None,
    strategy: Annotated[
        str | None, typer.Option(help="Control strategy at the start (default: as in the descriptor).")
    ] = None,
    driver: Annotated[
        SimulatedDriver | None, typer.Option(help="Also start a simulated driver: `sim` without mass, `physics` with.")
    ] = None,
    drives: Annotated[
        str | None,
        typer.Option(
            metavar="PRESET|FILE",
            help="Drives of the physical driver: ideal, industrial, hobby, m1013, or a file.",
            show_default=False,
        ),
    ] = None,
    world: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|FILE", help="The world of the physical driver, see `zarm world list`.", show_default=False
        ),
    ] = None,
    perception: Annotated[
        bool, typer.Option("--perception", help="Also make a voxel map from depth cameras, which motions avoid.")
    ] = False,
    map_box: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z,X,Y,Z",
            help="The box of the voxel map in the base frame: its least and its greatest x, y, z in m.",
            show_default=False,
        ),
    ] = None,
    map_resolution: Annotated[
        str | None, typer.Option(metavar="M", help="Width of a voxel, 0.005 to 0.1 m.", show_default=False)
    ] = None,
    ros: Annotated[bool, typer.Option("--ros", help="Also start the ROS 2 bridge.")] = False,
    moveit: Annotated[
        bool, typer.Option("--moveit", help="Also start the ROS 2 bridge, with the interface of MoveIt's move_group.")
    ] = False,
    group: Annotated[
        str, typer.Option(help="The name of the planning group that clients of MoveIt give.", metavar="NAME")
    ] = "arm",
    connect: Annotated[
        str | None, typer.Option(envvar="ZARM_CONNECT", help="Join the router at this endpoint instead of running one.")
    ] = None,
    listen: Annotated[
        str | None,
        typer.Option(
            envvar="ZARM_LISTEN", help=f"Where the router listens.  [default: {DEFAULT_ENDPOINT}]", show_default=False
        ),
    ] = None,
    state: Annotated[Path | None, typer.Option(help=f"Folder for saved state.  [default: {default_state()}]")] = None,
    metrics: Annotated[
        str | None,
        typer.Option(
            envvar="ZARM_METRICS",
            metavar="HOST:PORT",
            help="Address of the planner's Prometheus metrics; executor, bridge, driver and servo use the ports after it.",
        ),
    ] = None,
    meshes: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FOLDER", help="A folder whose mesh files the scene may use, besides those in $ZARM_MESHES."
        ),
    ] = None,
    speed: Annotated[
        float,
        typer.Option(
            envvar="ZARM_SIM_SPEED",
            min=1.0,
            max=MAX_SPEED,
            metavar="N",
            help="Simulate N times as fast as real time, 1 to 20: for robots without hardware.",
        ),
    ] = 1.0,
    view: Annotated[bool, typer.Option("--view", help="Also serve the browser page.")] = False,
    view_at: Annotated[
        str, typer.Option(envvar="ZARM_VIEW", metavar="HOST:PORT", help="Where the page is served.")
    ] = VIEW,
) -> None:
    """Start router, planner, servo and executor of one robot; Ctrl-C stops them, the robot first."""
    typed = {name for name in ("connect", "listen") if _typed(context, name)}
    if typed == {"listen"}:  # an option beats the environment
        connect = None
    if typed == {"connect"}:
        listen = None
    if connect is not None and listen is not None:
        raise typer.BadParameter(
            "one joins a router, the other runs one (ZARM_CONNECT and ZARM_LISTEN count)",
            param_hint="--connect / --listen",
        )
    if _typed(context, "group") and not moveit:
        raise typer.BadParameter("this is for clients of MoveIt; add --moveit", param_hint="--group")
    with (
        suppress(KeyboardInterrupt),  # the usual end
        launch(
            robot,
            name=name,
            strategy=strategy,
            driver=driver,
            physics=_physics(driver, drives, world),
            perception=_map(perception, map_box, map_resolution),
            ros=ros,
            moveit=group if moveit else None,
            connect=connect,
            listen=listen or DEFAULT_ENDPOINT,
            state=state or default_state(),
            meshes=meshes or (),
            metrics=metrics,
            view=view_at if view else None,
            speed=speed,
        ) as stack,
    ):
        stack.wait_ready(lambda _: None)  # the services' own log lines report it
        _say_ready(stack, joined=connect is not None, speed=speed)
        stack.wait()


def _map(perception: bool, box: str | None, resolution: str | None) -> list[str] | None:
    """The arguments of the perception, None if there is to be none. Raises BadParameter for options without it."""
    given = {"box": box, "resolution": resolution}
    words = [f"--{option}={value}" for option, value in given.items() if value is not None]
    if words and not perception:
        option = next(option for option, value in given.items() if value is not None)
        raise typer.BadParameter("this is for the voxel map; add --perception", param_hint=f"--map-{option}")
    return words if perception else None


def _physics(driver: SimulatedDriver | None, drives: str | None, world: str | None) -> list[str]:
    """The arguments of the physical driver. Raises BadParameter if another one is started."""
    given = {"--drives": drives, "--world": world}
    words = [word for option, value in given.items() if value is not None for word in (option, str(value))]
    if words and driver is not SimulatedDriver.physics:
        raise typer.BadParameter("this is for the physical driver; start it with --driver physics", param_hint=words[0])
    return words


def _typed(context: typer.Context, name: str) -> bool:
    """Whether an option stands in the command line, not in the environment."""
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def _say_ready(stack: Stack, *, joined: bool, speed: float) -> None:
    client = stack.client
    first, *rest = stack.robot.descriptor.home
    endpoint = client.connection.bus.endpoint
    where = "" if endpoint == resolved_endpoint(DEFAULT_ENDPOINT) else f" --connect {endpoint}"
    if joined:  # the bus may have other robots
        where += f" --name {client.name}"
    out.print(
        facts(
            ("robot", client.name),
            ("endpoint", endpoint),
            ("strategy", client.strategy().active),
            *(
                []
                if speed == 1.0
                else [
                    (
                        "speed",
                        f"{speed:g} times real time; programs that stream or publish need ZARM_SIM_SPEED={speed:g}",
                    )
                ]
            ),
        )
    )
    move = numbers([first + 0.5, *rest]).replace(" ", "")
    out.print(f"Try in another terminal: zarm execute --joints {move}{where}", soft_wrap=True)
    out.print("Ctrl-C stops everything.")
