"""Ways to move the robot, one small class each, behind one interface."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from zarm_contract.errors import InvalidRequest
from zarm_contract.keys import Keys
from zarm_contract.messages import JointState
from zarm_contract.robot import Robot
from zarm_executor.strategies.driver import DriverStrategy
from zarm_executor.strategies.driver_link import DriverLink
from zarm_executor.strategies.emulator import EmulatedRobot, Emulator
from zarm_executor.strategies.ghost import GhostOnly
from zarm_executor.strategies.joint_pose import JointPose
from zarm_executor.strategies.joint_speed import JointSpeed
from zarm_executor.strategies.joint_trajectory import JointTrajectory
from zarm_executor.strategies.repertoire import Repertoire
from zarm_runtime.bus import Bus
from zarm_runtime.state_file import StateFile

DRIVER_STRATEGIES: tuple[type[DriverStrategy], ...] = (JointSpeed, JointPose, JointTrajectory)
"""The strategies that need a driver, which may not be able to play all of them: a new one is a file and its name here."""


def build_strategies(robot: Robot, folder: Path, bus: Bus, keys: Keys) -> Repertoire:
    """Every strategy there is for this robot; none is open. What they keep on disk is in `folder`, drivers are on `bus`.

    Raises InvalidRequest where the descriptor names a strategy that there is not.
    """
    descriptor = robot.descriptor
    emulated = EmulatedRobot(descriptor, StateFile(folder / "emulated_robot.json", JointState))
    repertoire = Repertoire()
    repertoire.add(Emulator(emulated, np.array(descriptor.cspace.acceleration)))
    repertoire.add(GhostOnly(emulated))
    params = descriptor.strategy_params
    link = None if params is None else DriverLink(bus, keys, descriptor, params)
    known = tuple(strategy.name for strategy in DRIVER_STRATEGIES)
    playable = known if params is None or params.strategies is None else params.strategies
    for name in playable:
        if name not in known:
            raise InvalidRequest(
                f"{robot.path}: there is no strategy {name!r} for drivers; choose among {', '.join(known)}",
                field="strategy_params.strategies",
            )
    for strategy in DRIVER_STRATEGIES:
        if params is None or link is None:
            repertoire.rule_out(
                strategy.name,
                f"the descriptor of {descriptor.name} has no strategy_params; robots/README.md explains what to write there",
            )
        elif strategy.name not in playable:
            repertoire.rule_out(
                strategy.name,
                f"strategy_params.strategies of {descriptor.name} does not list it, because its driver cannot play it; it "
                f"plays {', '.join(playable)}",
            )
        else:
            repertoire.add(strategy(link))
    return repertoire
