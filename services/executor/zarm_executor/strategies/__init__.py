"""Control strategies, one small class each, behind one interface."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from zarm_contract.keys import Keys
from zarm_contract.messages import JointState
from zarm_contract.robot import RobotDescription
from zarm_contract.strategies import DRIVER_STRATEGIES
from zarm_executor.strategies.driver import DriverStrategy
from zarm_executor.strategies.driver_link import DriverLink
from zarm_executor.strategies.emulator import EmulatedRobot, Emulator
from zarm_executor.strategies.executors import Executors
from zarm_executor.strategies.executors_link import ExecutorsLink
from zarm_executor.strategies.ghost import GhostOnly
from zarm_executor.strategies.registry import StrategyRegistry
from zarm_runtime.bus import Bus
from zarm_runtime.state_file import StateFile
from zarm_trajectory.rate_bounds import RateLimits


def build_strategies(robot: RobotDescription, folder: Path, bus: Bus, keys: Keys) -> StrategyRegistry:
    """All strategies for this robot; none is open. Their files are in `folder`, and drivers are on `bus`."""
    descriptor = robot.descriptor
    emulated = EmulatedRobot(descriptor, StateFile(folder / "emulated_robot.json", JointState))
    registry = StrategyRegistry()
    registry.add(Emulator(emulated, RateLimits.of(descriptor)))
    registry.add(GhostOnly(emulated))
    if descriptor.executors and descriptor.command_timing is not None:
        registry.add(Executors(ExecutorsLink(bus, descriptor, descriptor.command_timing)))
    params = descriptor.strategy_params
    link = None if params is None else DriverLink(bus, keys, robot, params)
    for name in DRIVER_STRATEGIES:
        if params is None or link is None:
            registry.rule_out(
                name,
                f"the descriptor of {descriptor.name} has no strategy_params; docs/reference/robot.md explains what to write there",
            )
        elif name not in params.strategies:
            registry.rule_out(
                name,
                f"strategy_params.strategies of {descriptor.name} does not list it, because its driver cannot play it; it "
                f"plays {', '.join(params.strategies)}",
            )
        else:
            registry.add(_driver_strategy(name)(link))
    return registry


def _driver_strategy(name: str) -> type[DriverStrategy]:
    """The class of a strategy, in the module of its name."""
    classes = vars(import_module(f"{__name__}.{name}")).values()
    return next(one for one in classes if isinstance(one, type) and vars(one).get("name") == name)
