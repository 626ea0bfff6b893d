"""Ways to move the robot, one small class each, behind one interface."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from zarm_contract.messages import JointState
from zarm_contract.robot import Robot
from zarm_executor.state_file import StateFile
from zarm_executor.strategies.base import Strategy
from zarm_executor.strategies.emulator import EmulatedRobot, Emulator
from zarm_executor.strategies.ghost import GhostOnly


def build_strategies(robot: Robot, folder: Path) -> dict[str, Strategy]:
    """Every strategy that this robot knows, by name; none is open. What they keep on disk is in `folder`."""
    descriptor = robot.descriptor
    emulated = EmulatedRobot(descriptor, StateFile(folder / "emulated_robot.json", JointState))
    strategies = (Emulator(emulated, np.array(descriptor.cspace.acceleration)), GhostOnly(emulated))
    return {strategy.name: strategy for strategy in strategies}
