"""A robot behind a driver, as processes: the executor and the simulated driver on a router, and a client of both."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np

from support.executor.client import Client
from support.harness import ServiceProcess, eventually
from support.resources import favour
from support.trajectories import HOME, ROBOT, moved, patient, rest_to_rest
from zarm_contract.keys import Keys
from zarm_contract.messages import DriverCommand, DriverFault, ExecutorState, JointState
from zarm_contract.robot import RobotDescription
from zarm_runtime.bus import Bus

FAR = moved(1.0, -0.5, 0.3)
THERE = rest_to_rest(FAR, slower=1.5)
BACK = rest_to_rest(HOME, FAR, slower=1.5)
LIMIT = 1.2
"""The limit for commands to the driver, rad/s^2 (strategy_params.acceleration)."""


class Driven:
    """`client` talks to the executor; `reported` are the joint states published by the driver, `commands` those that it
    received.

    A robot that is `waited_for` may be silent for longer, as on a busy machine, before the executor gives it up.
    """

    def __init__(
        self,
        bus: Bus,
        endpoint: str,
        folder: Path,
        strategy: str,
        robot: RobotDescription = ROBOT,
        *,
        waited_for: bool = False,
    ) -> None:
        self.bus, self.endpoint, self.folder = bus, endpoint, folder
        self._descriptor = str(patient(folder / "patient", robot)) if waited_for else str(robot.path)
        self.strategy, self.joints = strategy, robot.descriptor.joints
        self.keys = keys = Keys(robot.descriptor.name)
        self.client = Client(bus, keys)
        self.reported: list[JointState] = []
        self.commands: list[DriverCommand] = []
        bus.subscribe(keys.driver_joint_states, lambda _, state: self.reported.append(state))
        bus.subscribe(keys.driver_command, lambda _, command: self.commands.append(command))
        self.driver: ServiceProcess
        self.executor: ServiceProcess

    def new_driver(self, *arguments: str) -> ServiceProcess:
        return ServiceProcess("leeloo_sim", self.endpoint, self.folder, self._descriptor, arguments=arguments)

    def new_executor(self) -> ServiceProcess:
        arguments = ("--strategy", self.strategy)
        return ServiceProcess("executor", self.endpoint, self.folder, self._descriptor, arguments=arguments)

    def set_fault(self, fault: DriverFault) -> None:
        """Give the driver a fault."""
        self.bus.call(self.keys.simulated_fault, fault, timeout=10)

    def arm(self) -> np.ndarray:
        """The last reported position of the arm, in the executor's order."""
        state = self.reported[-1]
        return np.array([state.position[state.joint_names.index(name)] for name in self.joints])

    def at_rest(self) -> np.ndarray:
        """Wait until the driver reports that the arm stands, and check that it stays; returns where."""
        eventually(lambda: self.reported and not any(self.reported[-1].velocity), "the arm stands")
        where, seen = self.reported[-1].position, len(self.reported)
        eventually(lambda: len(self.reported) > seen + 50, "the driver tells the joints")
        assert {state.position for state in self.reported[seen:]} == {where}
        return self.arm()

    def fault(self, code: str) -> ExecutorState:
        """Wait for the executor's fault, and check what it must say."""
        state = self.client.mode("fault")
        assert state.problem is not None
        assert state.problem.code == code, state.problem
        return state

    def works_again(self) -> None:
        """After a reset, the next goal, from where the arm stands, is reached."""
        start = self.at_rest()
        assert self.client.command(self.keys.reset).mode == "idle"
        assert self.client.ended(self.client.execute(rest_to_rest(HOME, start, slower=1.5))).status == "succeeded"
        np.testing.assert_allclose(self.at_rest(), HOME, atol=0.01)

    def commanded_acceleration(self) -> float:
        """The greatest change of velocity inside any command sent, rad/s^2."""
        return max(
            float(np.max(np.abs(np.diff(command.velocity, axis=0)))) / 0.02
            for command in self.commands
            if len(command.velocity) > 1
        )


@contextmanager
def driven(
    bus: Bus,
    endpoint: str,
    folder: Path,
    strategy: str,
    *driver: str,
    robot: RobotDescription = ROBOT,
    waited_for: bool = True,
) -> Iterator[Driven]:
    """The two processes, ready."""
    with ExitStack() as stack:
        arm = Driven(bus, endpoint, folder, strategy, robot, waited_for=waited_for)
        arm.driver = stack.enter_context(arm.new_driver(*driver))
        arm.driver.wait_ready(bus, arm.keys)
        arm.executor = stack.enter_context(arm.new_executor())
        arm.executor.wait_ready(bus, arm.keys)
        favour(arm.driver, arm.executor)
        yield arm
