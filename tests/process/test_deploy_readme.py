"""The lab guide: its commands parse, those of the simulated robot work as written, and its sentences are those of zarm."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
import typer

from support.command_line import Up, zarm
from support.harness import free_endpoint
from support.paths import ROOT
from zarm_cli.commands import command_line

README = (ROOT / "deploy" / "README.md").read_text()


def commands(text: str) -> list[list[str]]:
    """Every `zarm ...` line in the shell blocks of a text, as words."""
    blocks = re.findall(r"```sh\n(.*?)```", text, re.DOTALL)
    lines = [line.strip() for block in blocks for line in block.splitlines()]
    return [shlex.split(line, comments=True) for line in lines if line.startswith("zarm ")]


def section(heading: str) -> str:
    return README.split(f"\n## {heading}\n", 1)[1].split("\n## ", 1)[0]


def parse(words: list[str]) -> None:
    """Raises what a person would be told of a command line that cannot be read."""
    command, context, rest = typer.main.get_command(command_line()), None, words
    while True:
        context = command.make_context(rest[0], rest[1:], parent=context)
        if not hasattr(command, "resolve_command"):
            return
        left = [*context._protected_args, *context.args]
        _, command, arguments = command.resolve_command(context, left)
        rest = [left[0], *arguments]


@pytest.mark.parametrize("words", commands(README), ids=" ".join)
def test_every_command_of_the_guide_can_be_read(words: list[str]) -> None:
    parse(words)


@pytest.mark.parametrize(
    "words", [["zarm", "sing"], ["zarm", "plan", "--too", "1"], ["zarm", "scene", "add", "cuboid"]]
)
def test_one_that_cannot_be_read_is_noticed(words: list[str]) -> None:
    with pytest.raises(typer.TyperException):
        parse(words)


def test_the_simulated_robot_moves_by_the_commands_as_written(tmp_path: Path) -> None:
    up, *others = commands(section("1. One machine, simulated"))
    assert up[:2] == ["zarm", "up"]
    with Up(free_endpoint(), tmp_path, *up[2:]) as running:
        for words in others:
            if words[1] == "up":
                break
            done = zarm(*words[1:], ZARM_CONNECT=running.endpoint)
            assert done.returncode == 0, f"{words}: {done.stderr}"
        assert words[1:2] == ["up"]


def sentences() -> list[str]:
    """What the first column of the table of faults quotes, piece by piece."""
    rows = [line for line in section("When something does not work").splitlines() if line.startswith("| ")]
    return [piece for row in rows[1:] for piece in re.findall(r"`([^`]+)`", row.split(" | ")[0])]


def test_the_table_quotes_what_zarm_says() -> None:
    sources = "".join(path.read_text() for path in sorted((ROOT / "services").rglob("*.py")))
    joined = re.sub(r'"\s*\n\s*f?"', "", sources)
    system = {"No space left on device", "zarm status --json"}
    missing = [text for text in sentences() if text not in joined and text not in system]
    assert missing == []
    assert len(sentences()) > 25
