"""Robots of several robots: two Pandas on one table, and two small arms on a third one as their torso."""

from __future__ import annotations

from pathlib import Path

from support.paths import ROOT
from support.planner.small_arm import small_arm
from zarm_robot_import.composing import compose

TWO_PANDAS = (ROOT / "examples" / "two_pandas.yaml").read_text()

TORSO = """
name: torso_arms
parts:
  torso: {robot: small_arm.yaml}
  left: {robot: small_arm.yaml, on: torso, xyz: [0.0, 0.4, 0.15], rpy: [0.0, 0.6, 0.0]}
  right: {robot: small_arm.yaml, on: torso, xyz: [0.0, -0.4, 0.15], rpy: [0.0, 0.6, 1.0]}
"""


def composed(folder: Path, text: str) -> Path:
    """The descriptor of a composition, in `folder`."""
    file = folder / "composition.yaml"
    file.write_text(text, encoding="utf-8")
    return compose(file, folder / "made")


def two_pandas(folder: Path) -> Path:
    """The descriptor of two Pandas, 0.6 m apart."""
    return composed(folder, TWO_PANDAS)


def torso_with_arms(folder: Path) -> Path:
    """The descriptor of a tree of twelve joints, four of which carry both arms."""
    small_arm(folder)
    return composed(folder, TORSO)
