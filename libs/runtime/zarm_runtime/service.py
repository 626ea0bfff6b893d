"""The common frame of every service: arguments, one owner per robot, health, signals, a clean end."""

from __future__ import annotations

import argparse
import logging
import os
import secrets
import signal
import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, field
from pathlib import Path

from zarm_contract.codec import CONTRACT as CONTRACT
from zarm_contract.codec import build_all
from zarm_contract.errors import InvalidRequest, Unavailable, ZarmError
from zarm_contract.keys import Keys
from zarm_contract.messages import Health, Nothing
from zarm_contract.robot import RobotDescription, load_robot
from zarm_contract.roles import SERVICE_ROLES, Role
from zarm_runtime import clock, signals
from zarm_runtime.bus import Bus
from zarm_runtime.logs import name_robot, setup_logging
from zarm_runtime.metrics import Metrics, serve_metrics
from zarm_runtime.security import RENEWAL_DAYS, security_on
from zarm_runtime.session import DEFAULT_ENDPOINT
from zarm_runtime.version import version as version

log = logging.getLogger(__name__)

_WITHDRAWAL_TIMEOUT = 2.0
"""Seconds that a starting service gives another one, starting at the same moment, to withdraw."""

_OWNER_CHECK_PERIOD = 1.0
"""Interval (s) at which an older owner of the same robot is searched."""
_SEARCH_TIMEOUT = 0.3
"""Time limit (s) of that search, needed if no router is there."""


class _Stopped(Unavailable):
    """The service was told to end before it was ready."""


@dataclass
class Service:
    """A running service: its robot, its keys, its bus; `options` are its command line (`connect`, `state`, its own).

    `instance` sorts by start time.
    """

    name: str
    robot: RobotDescription
    keys: Keys
    bus: Bus
    options: argparse.Namespace
    instance: str = field(default_factory=lambda: f"{time.time_ns() // 1_000_000:011x}{secrets.token_hex(2)}")
    interruptible: Callable[[], None] = lambda: None
    """Raises if the service must not restart now; set by a service that moves something."""
    impairment: Callable[[], str | None] = lambda: None
    """A sentence on what keeps a ready service from serving; set by a service that monitors itself."""
    metrics: Metrics = field(default_factory=Metrics)
    """The metrics, which have no effect unless they are served."""
    end: Callable[[], None] = lambda: None
    """Ends the process in order."""
    outdated: bool = False
    """Whether the robot's file has changed, and the process is restarting to load it."""
    note: str = ""
    """Further information in `health`."""
    _activity: str = "starting"
    _ready: bool = False
    _started: float = field(default_factory=time.monotonic)

    def open_bus(self) -> Bus:
        """Another session of this service; use it in `with`."""
        return Bus(self.options.connect, role=self.bus.role)

    def starting(self, activity: str) -> None:
        """Report in `health` what the service does next before it is ready. Raises what `check_running` does."""
        self.check_running()
        self._activity = activity
        log.info("starting activity=%s", activity.replace(" ", "_"))

    def check_running(self) -> None:
        """Raise Unavailable after SIGTERM or SIGINT, which makes `run_service` end the process in order; for long starts."""
        if signals.received:
            raise _Stopped(f"the {self.name} is ending; wait until it is there again")

    def ready(self) -> None:
        """Report in `health` that requests are now served at full speed."""
        self._activity, self._ready = "serving", True
        log.info(
            "ready robot=%s instance=%s seconds=%.2f", self.keys.robot, self.instance, time.monotonic() - self._started
        )

    def health(self, _: Nothing | None = None) -> Health:
        """The health of this service."""
        impairment = self.impairment()
        return Health(
            service=self.name,
            robot=self.keys.robot,
            instance=self.instance,
            ready=self._ready and impairment is None,
            activity=impairment or self._activity,
            version=version(),
            contract=CONTRACT,
            robot_hash=self.robot.hash,
            uptime=time.monotonic() - self._started,
            pid=os.getpid(),
            note=self.note,
        )

    def reread(self, _: Nothing) -> Health:
        """Read the robot's file again; if it has changed, end, and restart with it in the same process.

        `health` shows when that is done. Raises InvalidRequest for a faulty file, Unavailable if it is ending, and what
        `interruptible` raises; then nothing has changed.
        """
        robot = load_robot(str(self.robot.path))
        if robot.hash != self.robot.hash:
            self.interruptible()
            self.starting("restarting with the changed robot")
            self._ready, self.outdated = False, True
            self.end()
        return self.health()

    def count(self) -> None:
        """Count its queries, and export its health as metrics."""

        def answered(key: str, outcome: str) -> None:
            relative = key.removeprefix(f"zarm/{self.keys.robot}/")
            self.metrics.count(
                "zarm_queries",
                "Requests answered; outcome is ok, the code of the problem, or unsent if no reply could be sent.",
                key=relative,
                outcome=outcome,
            )

        health = self.health()
        self.bus.watch_answers(answered)
        self.metrics.read(
            "gauge", "zarm_ready", "Whether the service is ready (0 or 1).", lambda: float(self.health().ready)
        )
        self.metrics.read(
            "gauge", "zarm_connected", "Whether the service has a router (0 or 1).", lambda: float(self.bus.connected)
        )
        self.metrics.read(
            "gauge",
            "zarm_service_info",
            "The service, its version, contract and robot; the value is always 1.",
            lambda: 1.0,
            service=self.name,
            version=health.version,
            contract=health.contract,
            robot_hash=health.robot_hash,
        )

    def claim(self) -> None:
        """Become the only owner of this service for the robot. Raises Unavailable while another one is alive.

        Close the bus after a refusal: this instance's token may be on it.
        """
        if others := self._others():
            raise self.taken(others)
        self.bus.declare_alive(self.keys.alive(self.name, self.instance))
        # An owner has seen no other token since it declared its own, so there is at most one. Of several that start at
        # the same moment, the one with the smallest id waits for the rest to withdraw; any that does not is an owner.
        deadline = time.monotonic() + _WITHDRAWAL_TIMEOUT
        while others := self._others():
            if min(others) < self.instance or time.monotonic() > deadline:
                raise self.taken(others)
            time.sleep(0.05)
        self.bus.serve(self.keys.health(self.name), self.health)
        self.bus.serve(self.keys.reread(self.name), self.reread, workers=1)

    def older_owner(self) -> str | None:
        """The instance of an owner that was there before this one, if it is on the bus.

        While a router is away its clients are not seen, and another instance may start as soon as the router is back,
        before the owner reconnects. The younger one, which started without need, must give way.
        """
        older = [instance for instance in self._others(_SEARCH_TIMEOUT) if instance < self.instance]
        return min(older, default=None)

    def _others(self, timeout: float = 1.0) -> list[str]:
        alive = self.bus.alive(self.keys.alive(self.name, "*"), timeout=timeout)
        return [instance for _, _, instance in alive if instance != self.instance]

    def taken(self, others: list[str]) -> Unavailable:
        """The error for a robot that these instances already own."""
        return Unavailable(
            f"a {self.name} for the robot {self.keys.robot} is already on this bus (instance {min(others)}); "
            "stop it, or start this one under another --name"
        )


def run_service(
    name: str, parser: argparse.ArgumentParser, start: Callable[[Service], AbstractContextManager[object]]
) -> int:
    """Run a service process until SIGTERM or SIGINT and return its exit code.

    `parser` comes from `service_parser`. `start(service)` returns a context manager that opens and closes the service
    of one robot; it calls `service.ready()`. If it cannot start, it raises a ZarmError, which results in one log line
    and exit code 1.
    """
    setup_logging(name)
    options = parser.parse_args()
    role = SERVICE_ROLES.get(name)
    ending = False

    def end() -> None:
        nonlocal ending
        ending = True
        signals.wake()

    signals.expect()
    signal.pthread_sigmask(signal.SIG_UNBLOCK, signals.ENDING)
    build_all()
    try:
        clock.read_speed()
        robots = _robots(options)
        name_robot(",".join(keys.robot for _, keys in robots))
        if security_on() and role is not None:
            _warn_of_end(role)
        with ExitStack() as stack:
            metrics_of = stack.enter_context(serve_metrics(options.metrics))
            services = [
                Service(name, robot, keys, stack.enter_context(Bus(options.connect, role=role)), options, end=end)
                for robot, keys in robots
            ]
            for service in services:
                service.metrics = metrics_of(service.keys.robot)
                service.count()
                service.claim()
                stack.enter_context(start(service))
            refusal = None
            while refusal is None:
                signals.wait(_OWNER_CHECK_PERIOD)
                if ending or signals.received:
                    break
                refusal = next(
                    (service.taken([older]) for service in services if (older := service.older_owner())), None
                )
            log.info("stopping")
        if refusal is not None:
            raise refusal
        if any(service.outdated for service in services):
            signal.pthread_sigmask(signal.SIG_BLOCK, signals.ENDING)  # signals from now on wait for the next program
            if not signals.received:
                sys.stdout.flush()
                os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])  # noqa: S606 - this very program
    except _Stopped:
        log.info("stopping")
    except ZarmError as error:
        log.error("cannot run reason=%s", error)
        return 1
    return 0


def _warn_of_end(role: Role) -> None:
    from zarm_runtime.certificates import Certificates

    certificates = Certificates(role)
    if certificates.days_left < RENEWAL_DAYS:
        log.warning(
            "certificate ends soon file=%s days=%.0f remedy=zarm_certs_%s",
            certificates.certificate,
            certificates.days_left,
            certificates.folder,
        )


def _robots(options: argparse.Namespace) -> list[tuple[RobotDescription, Keys]]:
    robots = [load_robot(robot) for robot in _each(options.robot)]
    names = _each(options.name) or [robot.descriptor.name for robot in robots]
    if len(names) != len(robots):
        raise InvalidRequest(f"{len(names)} names for {len(robots)} robots; give one for each, or none", field="--name")
    if len(set(names)) < len(names):
        raise InvalidRequest("a name appears twice; give each robot a name of its own", field="--name")
    return [(robot, _keys(name)) for robot, name in zip(robots, names, strict=True)]


def _each(option: str | list[str] | None) -> list[str]:
    return [option] if isinstance(option, str) else option or []


def _keys(robot: str) -> Keys:
    try:
        return Keys(robot)
    except ValueError as error:
        raise InvalidRequest(str(error), field="--name") from error


def default_state() -> Path:
    """The folder for state: `$ZARM_STATE`, else `$XDG_STATE_HOME/zarm`, else `~/.local/state/zarm`."""
    if folder := os.environ.get("ZARM_STATE"):
        return Path(folder)
    return Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state") / "zarm"


def service_parser(name: str, *, several: bool = False) -> argparse.ArgumentParser:
    """The command line common to all services; a service adds its own options. `several`: one process may serve several
    robots.
    """
    parser = argparse.ArgumentParser(f"zarm-{name.replace('_', '-')}", description=f"The zarm {name} of one robot.")
    count = "+" if several else None
    robot, instance = os.environ.get("ZARM_ROBOT", "doosan_m1013"), os.environ.get("ZARM_NAME")
    parser.add_argument(
        "--robot",
        default=[robot] if several else robot,
        help="the robot: the name of a descriptor, or the path of a .yaml file",
        nargs=count,
    )
    parser.add_argument(
        "--name",
        default=[instance] if several and instance is not None else instance,
        help="the name of the robot on the bus (default: the name in the descriptor)",
        nargs=count,
    )
    parser.add_argument(
        "--connect", default=os.environ.get("ZARM_CONNECT", DEFAULT_ENDPOINT), help="the endpoint of the router"
    )
    parser.add_argument(
        "--metrics",
        default=os.environ.get("ZARM_METRICS") or None,
        metavar="HOST:PORT",
        help="serve metrics for Prometheus at this address (default: none)",
    )
    parser.add_argument("--state", type=Path, default=default_state(), help="the folder for saved state")
    return parser
