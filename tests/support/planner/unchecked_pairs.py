"""An arm some of whose pairs of links the search does not check."""

from __future__ import annotations

import shutil
from itertools import product
from pathlib import Path

import yaml

from support.paths import ROOT
from zarm_contract.robot import load_robot
from zarm_geometry.robot_model import RobotModel

JOINTS = (0.4, -2.8, -1.6, 2.8, -2.5, -2.1)
"""Joints (rad) for whose pose the solution nearest to home has the wrist in the fore arm; they themselves are free."""


def unchecked_pairs(folder: Path) -> RobotModel:
    """A UR10e whose wrist is checked against upper and fore arm only in exact geometry."""
    descriptor = yaml.safe_load((ROOT / "robots" / "ur10e.yaml").read_text())
    arm, wrist = ("upper_arm_link", "forearm_link"), ("wrist_2_link", "wrist_3_link")
    descriptor["self_collision_exact"] = [list(pair) for pair in product(arm, wrist)]
    shutil.copy(ROOT / "robots" / "ur10e.urdf", folder)
    (folder / "ur10e.yaml").write_text(yaml.safe_dump(descriptor))
    return RobotModel.of(load_robot(str(folder / "ur10e.yaml")))
