"""The viewer process: a page in the browser that shows the robots on a bus, and moves them if its role may."""

from __future__ import annotations

import argparse
import logging
import os
import ssl
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from zarm.connection import Connection, keys_of, opened, robots
from zarm.robot import Robot
from zarm_contract.errors import InvalidRequest, Unavailable, ZarmError
from zarm_contract.robot import ROBOTS, RobotDescription, load_robot
from zarm_contract.roles import Role
from zarm_runtime import signals
from zarm_runtime.logs import setup_logging
from zarm_runtime.mesh_folders import add_meshes
from zarm_runtime.security import client_role, security_on
from zarm_runtime.service import default_state
from zarm_runtime.session import DEFAULT_ENDPOINT
from zarm_viewer.gate import Gate
from zarm_viewer.page import Folders, Page, Shown
from zarm_viewer.playback import Playback

log = logging.getLogger(__name__)

LISTEN = "127.0.0.1:8017"
"""Default address of the page."""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser("zarm-viewer", description="A page in the browser that shows and moves robots.")
    parser.add_argument(
        "--robot",
        action="append",
        metavar="[NAME=]DESCRIPTOR",
        help="a robot on the bus and its descriptor, a name or the path of a .yaml file; repeatable (default: $ZARM_ROBOT, else every robot on the "
        "bus whose descriptor comes with zarm)",
    )
    parser.add_argument(
        "--connect", default=os.environ.get("ZARM_CONNECT", DEFAULT_ENDPOINT), help="the endpoint of the router"
    )
    parser.add_argument(
        "--listen",
        default=os.environ.get("ZARM_VIEW", LISTEN),
        metavar="HOST:PORT",
        help="where the page is served (default: $ZARM_VIEW, else %(default)s); on an address beyond this machine it asks for a token",
    )
    parser.add_argument(
        "--role",
        choices=("viewer", "operator"),
        help="a viewer sees everything and can only stop (default: $ZARM_ROLE, else operator)",
    )
    add_meshes(parser)
    parser.add_argument(
        "--record",
        type=Path,
        metavar="FILE",
        help="play this record of `zarm record` or of a flight recorder, without a bus",
    )
    parser.add_argument(
        "--state",
        type=Path,
        default=default_state(),
        help="the folder for saved state: named poses",
    )
    parser.add_argument(
        "--records",
        type=Path,
        default=Path(folder) if (folder := os.environ.get("ZARM_RECORDS")) else None,
        metavar="FOLDER",
        help="the executor's folder for saved state, where it can be read from here: records of faults are downloaded from it (default: "
        "$ZARM_RECORDS, else --state)",
    )
    return parser


def main() -> int:
    """Serve the page until SIGTERM or SIGINT; the exit code."""
    signals.expect()
    options = parser().parse_args()
    setup_logging("viewer")
    try:
        with ExitStack() as stack:
            role: Role = options.role or client_role()
            gate = Gate.at(options.listen, tls=_tls(role), token=os.environ.get("ZARM_VIEW_TOKEN") or None)
            if options.record is not None:
                shown = [_recorded(options.record, options.robot)]
            else:
                shown = []
                for name, description in _described(options.robot or _own(), options.connect, role):
                    bus = stack.enter_context(opened(options.connect, role, timeout=10.0))
                    shown.append(Shown(Robot(Connection.of(bus, keys_of(name))), description))
            folders = Folders(tuple(options.meshes), options.state, options.records or options.state)
            page = Page(shown, gate, role, folders)
            stack.callback(page.close)
            log.info("ready page=%s role=%s robots=%s", page.address, role, ",".join(one.name for one in shown))
            print(page.address, flush=True)  # noqa: T201 - what is opened in the browser
            while not signals.received:
                signals.wait()
    except ZarmError as error:
        log.error("cannot run reason=%s", error)
        return 1
    return 0


def _described(wanted: Sequence[str] | None, connect: str, role: Role) -> list[tuple[str, RobotDescription]]:
    """The robots to show, by name on the bus."""
    if wanted:
        return [_named(word) for word in wanted]
    known = {robot.hash: robot for robot in map(load_robot, map(str, sorted(ROBOTS.glob("*.yaml"))))}
    names = robots(connect, role=role, timeout=10.0)
    if not names:
        raise Unavailable(f"no robot is alive on the bus at {connect}; start one with `zarm up`")
    found = []
    with opened(connect, role) as bus:
        for name in names:
            client = Robot(Connection.of(bus, keys_of(name)))
            description = known.get(_hash(client))
            if description is None:
                log.warning("robot not shown name=%s reason=unknown_descriptor remedy=--robot_%s=FILE", name, name)
            else:
                found.append((name, description))
    if not found:
        raise InvalidRequest(
            f"the descriptor of {', '.join(names)} does not come with zarm; name it: --robot NAME=FILE.yaml",
            field="--robot",
        )
    return found


def _recorded(file: Path, wanted: Sequence[str] | None) -> Shown:
    """The robot of a record: the requested descriptor, or the one that comes with zarm under its name."""
    playback = Playback(file)
    if wanted:
        return Shown(playback, _named(wanted[0])[1])
    name = playback.story.robot
    if not (ROBOTS / f"{name}.yaml").is_file():
        raise InvalidRequest(
            f"no descriptor comes with zarm for {name}, the robot of {file}; name it: --robot FILE.yaml",
            field="--robot",
        )
    return Shown(playback, load_robot(name))


def _own() -> list[str]:
    """The robot named by the environment, as for every service."""
    robot, name = os.environ.get("ZARM_ROBOT"), os.environ.get("ZARM_NAME")
    return [f"{name}={robot}" if name else robot] if robot else []


def _hash(client: Robot) -> str:
    for service in ("executor", "planner"):
        try:
            return client.health(service).robot_hash
        except Unavailable:
            continue
    return ""


def _named(word: str) -> tuple[str, RobotDescription]:
    name, equals, descriptor = word.partition("=")
    description = load_robot(descriptor if equals else word)
    return (name if equals else description.descriptor.name), description


def _tls(role: Role) -> ssl.SSLContext | None:
    """TLS, if the bus uses it too."""
    if not security_on():
        return None
    from zarm_runtime.certificates import Certificates

    return Certificates(role).of_page()


if __name__ == "__main__":
    sys.exit(main())
