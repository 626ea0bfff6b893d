"""A Panda with a driver: the descriptor that comes with zarm names none."""

from __future__ import annotations

import shutil
from pathlib import Path

from zarm_contract.robot import ROBOTS


def driven_panda(folder: Path) -> Path:
    """The descriptor of a Panda whose trajectories go to a driver."""
    for suffix in (".yaml", ".urdf"):
        shutil.copy(ROBOTS / f"panda{suffix}", folder)
    path = folder / "panda.yaml"
    params = "  command_topic: /panda/command\n  joint_states_topic: /joint_states\n"
    text = path.read_text(encoding="utf-8")
    path.write_text(
        text.replace("strategy: emulator\n", f"strategy: joint_trajectory\nstrategy_params:\n{params}"),
        encoding="utf-8",
    )
    return path
