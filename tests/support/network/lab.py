"""A workstation that plans and a machine beside the robot that executes: two hosts with their processes."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import numpy as np

from support.executor.client import Client
from support.harness import PATIENCE, eventually
from support.network.two_hosts import Host, Hosts
from support.network.wire import Quality
from support.resources import favour
from support.trajectories import HOME, KEYS, moved
from zarm_contract.errors import Unavailable
from zarm_contract.messages import JointGoal, Nothing, Plan, PlanRequest

AWAY = moved(0.5, -0.3, 0.2)


class Lab(Hosts):
    """The two hosts, a planner on the workstation, an executor on the robot's, and a client on each that sees
    everything.
    """

    def __init__(self, stack: ExitStack, folder: Path) -> None:
        super().__init__(stack, folder)
        self.here, self.there = Client(self.workstation.bus), Client(self.robot.bus)
        self.services = {
            name: stack.enter_context(host.service(name))
            for name, host in (("planner", self.workstation), ("executor", self.robot))
        }
        for service in self.services.values():
            service.wait_ready(self.workstation.bus, KEYS)
        self.workstation.bus.listen("zarm/**", lambda *_: None)  # as a record does: all of it goes over the wire
        eventually(lambda: self.here.measured, "the workstation hears the robot")

    def lose_each_other(self) -> None:
        """Cut the wire, and wait until the routers notice."""
        self.wire.become(Quality(cut=True))
        eventually(lambda: not self.workstation.bus.alive(KEYS.alive("executor", "*")), "the routers know")

    def restore(self) -> None:
        """Reconnect the wire, and wait until the workstation hears the executor again."""
        self.wire.become(Quality())
        eventually(self._answers, "the workstation hears the executor")

    def goes_on(self) -> None:
        """A plan from the workstation is executed as before, nothing was restarted, and each service exists once."""
        where = self.here.position()
        target = HOME if np.max(np.abs(where - HOME)) > 0.1 else AWAY
        found = self.plan(*target)
        end = self.here.ended(self.here.execute(plan_id=found.plan_id))
        assert end.status == "succeeded", end.problem
        np.testing.assert_allclose(self.here.position(), target, atol=0.01)
        for host in self:
            assert {one: process.process.pid for one, process in self.services.items()} == {
                one: host.bus.call(KEYS.health(one), Nothing(), timeout=PATIENCE).pid for one in self.services
            }
            owners = [service for _, service, _ in host.bus.alive(KEYS.alive("*", "*"), timeout=5)]
            assert [owners.count(one) for one in self.services] == [1, 1], owners

    def _answers(self) -> bool:
        try:
            return bool(self.workstation.bus.read(KEYS.executor_state, timeout=0.5))
        except Unavailable:
            return False

    def plan(self, *joints: float) -> Plan:
        goal = JointGoal(kind="joints", position=joints)
        return self.workstation.bus.call(KEYS.plan, PlanRequest(goal=goal), timeout=PATIENCE)

    def driver(self, host: Host) -> ExitStack:
        """The simulated driver on a host, with `joint_speed`; leaving switches back to the emulator."""
        with ExitStack() as stack:
            self.there.strategy("ghost")
            process = stack.enter_context(
                host.service("leeloo_sim", "--at", *(f"{joint:.6f}" for joint in self.there.position()))
            )
            process.wait_ready(host.bus, KEYS)
            favour(process)
            stack.callback(self.there.strategy, "emulator")
            eventually(self._driven, "the executor hears the driver")
            return stack.pop_all()

    def _driven(self) -> bool:
        try:
            return self.there.strategy("joint_speed").active == "joint_speed"
        except Unavailable:
            return False
