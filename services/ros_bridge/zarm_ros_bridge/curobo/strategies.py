"""The control strategy: the services of both versions, and the two parameters for it."""

from __future__ import annotations

import logging
import threading
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from pydantic import ValidationError
from std_srvs.srv import Trigger

from zarm_contract.errors import InvalidRequest, Unavailable, ZarmError
from zarm_contract.messages import StrategyRequest
from zarm_ros_bridge.answers import with_message
from zarm_ros_bridge.curobo.generations.generation import Generation
from zarm_ros_bridge.curobo.parameters import Parameters, robot_type
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.holds import waiting
from zarm_ros_bridge.ros import Ros
from zarm_runtime.worker import Worker

if TYPE_CHECKING:
    from curobo_msgs.srv import GetRobotStrategies, SetRobotStrategy

log = logging.getLogger(__name__)


class StrategyServices:
    """set_robot_strategy by both of its types, get_robot_strategy, get_robot_strategies. Use it in `with`.

    `first` is the participant of version 1. The parameters control_strategy and robot_type follow the executor, whoever
    switches: they are read again after every change, so that the last value written is the true one.
    """

    def __init__(self, ros: Ros, first: Ros, engine: Engine, parameters: Parameters, generation: Generation) -> None:
        self._engine = engine
        self._generation = generation
        self._parameters = parameters
        self._active = engine.robot.descriptor.strategy
        self._showing = threading.Lock()
        self._follower = Worker("strategy parameters", self._follow)
        parameters.on_change("control_strategy", self._switch, self._follower.wake)
        parameters.on_change("robot_type", self._check_type)
        generation.serve(ros, "SetRobotStrategy", "~/set_robot_strategy", with_message(self._set))
        ros.serve(Trigger, "~/get_robot_strategy", with_message(self._get))
        generation.serve(ros, "GetRobotStrategies", "~/get_robot_strategies", self._list)
        first.serve(Trigger, f"{ros.node.get_name()}/set_robot_strategy", with_message(self._set_chosen))

    def __enter__(self) -> Self:
        self._follower.wake()
        self._follower.start()
        self._engine.bus.watch(self._engine.keys.strategy, lambda _key, _strategies: self._follower.wake())
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._follower.stop()

    def _set(self, request: SetRobotStrategy.Request, response: SetRobotStrategy.Response) -> str:
        before = self._engine.client.strategy().active
        response.previous_robot_strategy = response.current_robot_strategy = before
        strategy = self._generation.strategy(request, self._engine.robot.descriptor.name)
        self._switch(strategy)
        response.current_robot_strategy = strategy
        return _switched(before, strategy) + self._condition()

    def _set_chosen(self, _: Any, __: Any) -> str:
        """Version 1: apply what robot_type says. If that fails, robot_type returns to the active one."""
        chosen = self._parameters.value("robot_type")
        try:
            before = self._type(self._engine.client.strategy().active)
            self._switch("joint_trajectory" if chosen == self._engine.robot.descriptor.name else chosen)
        except ZarmError:
            self._parameters.set("robot_type", self._type(self._active))
            raise
        return _switched(before, chosen) + self._condition()

    def _get(self, _: Any, __: Any) -> str:
        active = self._engine.client.strategy().active
        return self._generation.active(active, self._type(active)) + self._condition()

    def _condition(self) -> str:
        """What to add to the strategy: a fault, or a held goal."""
        state = self._engine.client.state()
        if state.problem is not None:
            return f"; the robot is in fault: {self._engine.terms.of(state.problem.message)}"
        held = waiting(self._engine.goal(state))
        return f"; {held}" if held else ""

    def _list(self, _: Any, response: GetRobotStrategies.Response) -> GetRobotStrategies.Response:
        """All of them, including those that cannot be switched to now: a client that asks before the driver starts sees
        them.
        """
        try:
            strategies = self._engine.client.strategy()
        except ZarmError as error:
            log.warning("strategies cannot be listed reason=%s", error)
            return response
        names = [one.name for one in strategies.strategies]
        response.strategy_names, response.strategy_ids = names, list(range(len(names)))
        response.current_strategy_name = strategies.active
        response.current_strategy_id = names.index(strategies.active)
        response.success = True
        return response

    def _switch(self, strategy: str) -> None:
        """Switch. Raises the ZarmError with the reason if that fails; the previous one then stays active."""
        try:
            request = StrategyRequest(strategy=strategy)
        except ValidationError:
            known = ", ".join(one.name for one in self._engine.client.strategy().strategies)
            raise InvalidRequest(f"there is no strategy {strategy!r}; this robot has {known}") from None
        self._engine.client.strategy(request.strategy)
        self._show()

    def _follow(self) -> None:
        try:
            self._show()
        except ZarmError as error:  # the executor is away, and publishes its strategy when it is back
            log.info("strategy unknown reason=%s", error)

    def _show(self) -> None:
        """Set the parameters to the executor's state. A robot_type that was chosen but not applied yet stays until a
        switch.
        """
        with self._showing:
            active = self._engine.client.strategy().active
            if self._parameters.value("control_strategy") != active:
                self._parameters.set("control_strategy", active)
            if self._active != active:
                self._active = active
                self._parameters.set("robot_type", self._type(active))

    def _check_type(self, chosen: str) -> None:
        """Raises InvalidRequest for a robot_type without a strategy in the executor; if that is away, applying it does."""
        try:
            known = [self._type(one.name) for one in self._engine.client.strategy().strategies]
        except Unavailable:
            return
        if chosen not in known:
            raise InvalidRequest(f"robot_type cannot be {chosen!r} for this robot; choose one of {', '.join(known)}")

    def _type(self, strategy: str) -> str:
        return robot_type(self._engine, strategy)


def _switched(before: str, after: str) -> str:
    return f"Strategy switched from '{before}' to '{after}'" if before != after else f"Strategy is '{after}' already"
