"""An M1013 with digital outputs."""

from __future__ import annotations

import shutil
from pathlib import Path

from zarm_contract.robot import ROBOTS, load_robot

M1013 = load_robot("doosan_m1013")


def with_outputs(folder: Path, vacuum: str = "{}") -> str:
    """Its descriptor in a folder, with a `vacuum` as described, and a torch whose driver has half a second."""
    for suffix in (".yaml", ".urdf"):
        shutil.copy(ROBOTS / f"doosan_m1013{suffix}", folder)
    path = folder / "doosan_m1013.yaml"
    path.write_text(path.read_text() + f"\noutputs:\n  vacuum: {vacuum}\n  torch: {{driver_timeout: 0.5}}\n")
    return str(path)
