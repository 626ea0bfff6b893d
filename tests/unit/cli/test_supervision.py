"""What is said of a program that ended: its own reason, not a line of another one's log."""

from __future__ import annotations

from pathlib import Path

import pytest

from support.harness import eventually
from zarm_cli.supervision import Supervisor

OTHER = "executor  | 10:00:00 level=INFO waiting reason=the planner is away"


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (["planner   | 10:00:00 level=ERROR ended reason=no such robot", OTHER], "no such robot"),
        (["ModuleNotFoundError: No module named 'numba'", OTHER], "ModuleNotFoundError: No module named 'numba'"),
        (['{"service": "planner", "fields": {"reason": "no robot"}}', OTHER], "no robot"),
    ],
)
def test_a_program_that_ends_has_its_own_last_words(
    lines: list[str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = "\n".join(lines)
    (tmp_path / "speaker.py").write_text(f"import sys, time\nprint({said!r}, flush=True)\nsys.stdin.read()\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with Supervisor({"planner": ("speaker", ())}, {}) as supervisor:
        assert eventually(lambda: supervisor.last_words("planner") == words, f"it says {words}")
