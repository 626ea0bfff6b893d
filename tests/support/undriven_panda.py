"""A Panda that nothing would drive: its descriptor names no driver."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

from zarm_contract.robot import ROBOTS


def undriven_panda(folder: Path) -> Path:
    """The descriptor of a Panda without strategy_params."""
    shutil.copy(ROBOTS / "panda.urdf", folder)
    text = (ROBOTS / "panda.yaml").read_text(encoding="utf-8")
    path = folder / "panda.yaml"
    path.write_text(re.sub(r"strategy_params:\n(  .*\n)+", "", text), encoding="utf-8")
    return path
