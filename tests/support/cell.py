"""A robot with its planner, executor and servo as processes, and a client for them."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import numpy as np

from support.executor.client import Client
from support.harness import ServiceProcess, eventually, router
from support.planner.client import BEHIND_POST, HOME, load, plan, to_joints
from support.planner.second_opinion import Collisions
from support.trajectories import KEYS, ROBOT, with_execution
from zarm_contract.messages import GoalState, PathConstraint, PlanRequest, SceneObject
from zarm_runtime.bus import Bus

SLOWLY = 0.3
GIVEN_UP_AFTER = 8.0


class Cell:
    """The processes around one robot, and a client for them."""

    def __init__(self, stack: ExitStack, folder: Path, execution: str, *services: str) -> None:
        self.stack, self.folder = stack, folder
        self.endpoint = stack.enter_context(router())
        self.bus = stack.enter_context(Bus(self.endpoint))
        self.descriptor = str(with_execution(folder / "robot", execution))
        self.services = {service: self.begin(service) for service in services}
        self.client = Client(self.bus)

    def begin(self, service: str) -> ServiceProcess:
        process = self.stack.enter_context(ServiceProcess(service, self.endpoint, self.folder, self.descriptor))
        process.wait_ready(self.bus, KEYS)
        return process

    def home(self) -> None:
        """Move home, in an empty scene."""
        self.client.cancel()
        self.client.mode("idle")
        load(self.bus)
        way = plan(self.bus, PlanRequest(goal=to_joints(*HOME)))
        assert self.client.ended(self.client.execute(plan_id=way.plan_id)).status == "succeeded"
        self.client.measured.clear()
        self.client.goals.clear()

    def way(
        self,
        *objects: SceneObject,
        speed: float = SLOWLY,
        replan: bool = False,
        path_constraint: PathConstraint | None = None,
    ) -> str:
        """A running goal through the place of the post, among these objects."""
        load(self.bus, *objects)
        goal = to_joints(*BEHIND_POST)
        made = plan(self.bus, PlanRequest(start=HOME, goal=goal, velocity_scale=speed, path_constraint=path_constraint))
        running = self.client.execute(plan_id=made.plan_id, replan=replan)
        self.client.under_way(running, 0.05)
        return running

    def held(self, goal: str) -> GoalState:
        """Wait until the goal is held; returns its state."""

        def state() -> GoalState | None:
            found = self.client.goal(goal)
            assert not found.done, found
            return found if found.hold is not None else None

        return eventually(state, "the goal is held")

    def rests(self) -> None:
        """Wait until the robot rests."""
        eventually(lambda: not any(self.client.measured[-1].velocity), "the robot rests")
        assert self.client.stands()

    def assert_free_of(self, *objects: SceneObject) -> None:
        """No configuration measured since the last check collided with any of them."""
        collisions = Collisions(ROBOT, objects)
        assert not any(collisions.at(np.array(state.position)) for state in self.client.measured)
