"""A robot behind a driver whose arm is observed from outside, for tests of faults."""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np

from support.executor.driven import FAR, THERE, Driven
from support.faults.wall_clock import WallClock
from support.harness import ServiceProcess, eventually, free_endpoint
from support.network.link import Link, link
from support.network.router_process import router_process
from support.resources import ahead_of_others, burden
from support.trajectories import HOME, plan, rest_to_rest
from zarm_contract.errors import Unavailable
from zarm_contract.messages import ExecutorState, JointState, Trajectory
from zarm_runtime.bus import Bus
from zarm_runtime.session import open_router
from zarm_simulated_driver.player import Kind

STEP = 0.01
"""Period of the simulated arm (s): counting its samples measures time on the arm's clock."""
_JOINTS = len(HOME)


class Arena(Driven):
    """`trace()` is the arm's true motion from the first moment on, whatever is silent, dead or cut off meanwhile.

    The arm follows any command, without limits of its own, and brakes by itself as the M1013 does, so that faulty
    commands become visible. The router can be restarted.

    With `wired`, executor and driver are connected by separate links and have their own clocks. With `stallable` the
    router is a process, `router`. The arm `plays` velocities or positions.
    """

    def __init__(
        self,
        stack: ExitStack,
        folder: Path,
        strategy: str,
        *,
        wired: bool,
        stallable: bool = False,
        plays: Kind = "velocity",
    ) -> None:
        self.folder = folder
        self._stack = stack
        endpoint = free_endpoint()
        self._router = stack.enter_context(ExitStack())
        with ahead_of_others():
            if stallable:
                self.router = self._router.enter_context(router_process(endpoint))
            else:
                self._router.enter_context(open_router(endpoint))
        super().__init__(stack.enter_context(Bus(endpoint)), endpoint, folder, strategy)
        self._lines = (folder / "trace.csv").open("a+")
        stack.callback(self._lines.close)
        self._trace = np.empty((0, 2 * _JOINTS))
        self._reading = threading.Lock()
        self._warm: int | None = None
        self._rest = ""
        self.links: dict[str, Link] = {}
        self.clocks: dict[str, WallClock] = {}
        if wired:
            for name in ("executor", "driver"):
                with ahead_of_others():
                    self.links[name] = stack.enter_context(link(endpoint))
                self.clocks[name] = WallClock(folder / f"{name}.clock")
        arguments = ("--ceiling", "1000", "--plays", plays, "--trace", str(folder / "trace.csv"))
        with ahead_of_others():
            self.driver = stack.enter_context(self._wired(self.new_driver(*arguments), "driver"))
        self.driver.wait_ready(self.bus, self.keys)
        self.restart_executor()

    def _wired(self, process: ServiceProcess, name: str) -> ServiceProcess:
        if name not in self.links:
            return process
        environment = self.clocks[name].environment
        return dataclasses.replace(process, endpoint=self.links[name].endpoint, environment=environment)

    def restart_executor(self) -> None:
        """Start an executor if there is none any more."""
        with ahead_of_others():
            self.executor = self._stack.enter_context(self._wired(self.new_executor(), "executor"))
        self.executor.wait_ready(self.bus, self.keys)

    def stop_router(self) -> None:
        """Stop the router."""
        self._router.close()

    def start_router(self) -> None:
        """Start a router again, with driver and executor connected."""
        with ahead_of_others():
            self._router.enter_context(open_router(self.endpoint))
        self.all_heard()

    def all_heard(self) -> None:
        """Wait until the driver and the executor are heard."""
        seen = len(self.reported)
        eventually(lambda: len(self.reported) > seen, "the driver is heard")
        self.heard()

    def ghost(self) -> list[JointState]:
        """The ghost's messages, stamped by the executor's own clock: it has a plan to play by now."""
        shown: list[JointState] = []
        self.bus.subscribe(self.keys.preview_joint_states, lambda _, state: shown.append(state))
        plans = self.bus.publisher(self.keys.plans)
        eventually(lambda: plans.put(plan("seen", THERE)) or shown, "the ghost plays")
        return shown

    # -- the arm --

    def trace(self) -> np.ndarray:
        """The arm's motion so far (N, 2J): positions (rad), velocities (rad/s), a row every `STEP`."""
        with self._reading:
            *lines, self._rest = (self._rest + self._lines.read()).split("\n")
            if lines:
                rows = [[float(value) for value in line.split(",")] for line in lines]
                self._trace = np.concatenate((self._trace, rows))
            return self._trace

    def samples(self) -> int:
        """How many steps the arm has made."""
        return len(self.trace())

    def true_position(self) -> np.ndarray:
        """The arm's position (J,)."""
        where: np.ndarray = self.trace()[-1, :_JOINTS]
        return where

    def speed(self) -> float:
        """The present speed of the fastest joint, rad/s."""
        return float(np.abs(self.trace()[-1, _JOINTS:]).max())

    def stands_for(self, count: int) -> bool:
        """Whether the arm has not moved in its last `count` steps."""
        rows = self.trace()[-count:]
        return len(rows) == count and not rows[:, _JOINTS:].any() and bool(np.all(rows == rows[0]))

    def wait_to_stand(self, count: int = 20) -> None:
        """Wait until the arm has not moved for this many steps."""
        eventually(lambda: self.stands_for(count), "the arm stands")

    # -- the executor --

    def motion(self) -> Trajectory:
        """A motion from the arm's position, as long as from `HOME` to `FAR`, towards the further one of these."""
        here = self.true_position()
        nearer_home = np.abs(HOME - here).max() < np.abs(FAR - here).max()
        return rest_to_rest(here + (FAR - HOME if nearer_home else HOME - FAR), here)

    def go(self) -> str:
        """Start a motion that takes a while; returns the goal."""
        return self.client.execute(self.motion())

    def nudge(self) -> None:
        """Move a little, and arrive."""
        here = self.true_position()
        middle = (HOME + FAR) / 2
        there = here + 0.05 * np.sign(middle - here) * (np.abs(middle - here) > 0.05)
        end = self.client.ended(self.client.execute(rest_to_rest(there, here)))
        assert end.status == "succeeded", end
        self.wait_to_stand()
        np.testing.assert_allclose(self.true_position(), there, atol=0.01)

    def heard(self) -> ExecutorState:
        """The executor's state, as soon as an executor publishes it."""

        def state() -> ExecutorState | None:
            try:
                return self.client.state()
            except Unavailable:
                return None

        return eventually(state, "the executor is heard")

    def warm_up(self) -> None:
        """Use a new executor until all its lazily started threads exist."""
        process, burdens = self.executor.process.pid, [self.burden()]
        while self._warm != process and (len(burdens) < 3 or burdens[-1] != burdens[-2]):
            self.nudge()
            for key in (self.keys.stop, self.keys.reset):
                self.client.command(key)
            burdens.append(self.burden())
        self._warm = process

    def burden(self) -> tuple[int, int]:
        """The executor's numbers of threads and of file descriptors."""
        now = burden(self.executor)
        return now.threads, now.descriptors


@contextmanager
def arena(folder: Path, strategy: str, *, wired: bool = False) -> Iterator[Arena]:
    """Everything started."""
    with ExitStack() as stack:
        yield Arena(stack, folder, strategy, wired=wired)
