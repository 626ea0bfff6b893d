"""Where things are: the repository, what lies beside it, and the programs that tests start."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[2]
SHARED = ROOT.parent / "shared"
PROGRAMS = Path(__file__).parent / "programs"
MESHES = ROOT / "examples" / "meshes"
EXAMPLES = ROOT / "services" / "executor" / "examples"
