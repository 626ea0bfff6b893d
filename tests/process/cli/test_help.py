"""What `zarm` says of itself."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator

import pytest
import typer
from typer.testing import CliRunner

from support.command_line import the_one_line, zarm
from support.tiers import sampled
from zarm_cli.commands import MODULES, command_line
from zarm_contract.codec import CONTRACT
from zarm_runtime.version import version

ALL = command_line()


def commands() -> Iterator[tuple[str, ...]]:
    """Every command that there is, in words."""
    yield ()
    for name, command in typer.main.get_command(ALL).commands.items():  # type: ignore[attr-defined]
        yield (name,)
        yield from ((name, below) for below in getattr(command, "commands", ()))


@pytest.mark.parametrize("words", list(commands()), ids=" ".join)
def test_help_fits_a_terminal_of_80_columns(words: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    shown = CliRunner().invoke(ALL, [*words, "--help"])
    assert shown.exit_code == 0
    assert max(len(line) for line in shown.output.splitlines()) <= 80
    assert "…" not in shown.output


@pytest.mark.parametrize("name", sampled(*MODULES))
def test_a_command_that_is_loaded_alone_is_the_same(name: str) -> None:
    alone, among_all = (CliRunner().invoke(app, [name, "--help"]).output for app in (command_line([name]), ALL))
    assert alone == among_all


@pytest.mark.parametrize("name", ["status", "stop", "pause", "speed", "cancel"])
def test_a_short_command_loads_nothing_that_takes_long(name: str) -> None:
    program = f"import sys; from zarm_cli.commands import command_line; command_line(['{name}']); print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout.split()
    heavy = {"cryptography", "numpy", "rich.live", "rich.progress", "ssl", "supervisor", "yaml", "zarm_contract.robot"}
    assert heavy & set(loaded) == set()


def test_the_version_is_told() -> None:
    assert the_one_line(zarm("--version").stdout) == f"zarm {version()}, contract {CONTRACT}"
