"""The guides: their commands parse, those of the tutorials work as written, and their sentences are those of zarm."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from contextlib import ExitStack
from importlib.util import find_spec
from pathlib import Path

import pytest
import typer

from support.command_line import Command, Up, environment, zarm
from support.harness import PATIENCE, free_endpoint
from support.markdown import PAGES, ROOT, commands, python_blocks, section
from support.tiers import sampled
from support.viewer import free_port
from zarm_cli.commands import command_line

DOCS = ROOT / "docs"
COMMISSIONING = (DOCS / "how-to" / "commission-a-robot.md").read_text()
ENDPOINT = "tcp/127.0.0.1:7447"
IMPORTED = 400.0
"""So long (s) may the import of an arm take on a busy machine; it takes half a minute of CPU."""
FOLLOWED = {
    "commissioning": section(COMMISSIONING, "1. One machine, simulated").split("The same through ROS", 1)[0],
    **{path.stem: path.read_text().split("## From ROS 2", 1)[0] for path in (DOCS / "tutorials").glob("[!i]*.md")},
}
"""What is followed here from its first command to its last; what goes through ROS is followed with the tests of the bridge."""
TYPED = [(path, words) for path in PAGES for words in commands(path.read_text(), "zarm")]


ALL = typer.main.get_command(command_line())


def parse(words: list[str]) -> None:
    """Raises what a person would be told of a command line that cannot be read."""
    command, context, rest = ALL, None, words
    while True:
        context = command.make_context(rest[0], rest[1:], parent=context)
        if not hasattr(command, "resolve_command"):
            return
        left = [*context._protected_args, *context.args]
        _, command, arguments = command.resolve_command(context, left)
        rest = [left[0], *arguments]


@pytest.mark.parametrize("words", [pytest.param(words, id=f"{path.stem}: {' '.join(words)}") for path, words in TYPED])
def test_every_command_can_be_read(words: list[str]) -> None:
    parse(words)


@pytest.mark.parametrize(
    "words", [["zarm", "sing"], ["zarm", "plan", "--too", "1"], ["zarm", "scene", "add", "cuboid"]]
)
def test_one_that_cannot_be_read_is_noticed(words: list[str]) -> None:
    with pytest.raises(typer.TyperException):
        parse(words)


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("guide", sampled(*FOLLOWED))
def test_the_simulated_robot_moves_by_the_commands_as_written(
    guide: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    arm = find_spec("airo_models")
    assert arm
    assert arm.submodule_search_locations
    shutil.copytree(Path(arm.submodule_search_locations[0]) / "arms" / "ur3e", tmp_path / "ur3e")
    every = commands(FOLLOWED[guide], "zarm", "zenoh")
    first = next(i for i, words in enumerate(every) if words[:2] == ["zarm", "up"])
    for words in every[:first]:
        if words[1:3] == ["robot", "edit"]:
            _edit(tmp_path, words[1:])
            continue
        done = zarm(*words[1:], timeout=IMPORTED)
        assert done.returncode == 0, f"{words}: {done.stderr}"
    up, *others = every[first:]
    with ExitStack() as running:
        started = running.enter_context(Up(free_endpoint(), tmp_path, *up[2:]))
        for words in others:
            if words[:2] == ["zarm", "up"]:
                running.close()
                started = running.enter_context(Up(free_endpoint(), tmp_path, *words[2:]))
            elif words[0] == "zenoh":
                assert _zenoh(words[1:], started.endpoint)
            else:
                done = zarm(*words[1:], ZARM_CONNECT=started.endpoint)
                assert done.returncode == 0, f"{words}: {done.stderr}"
        program = "\n".join(python_blocks(FOLLOWED[guide]))
        typed = [sys.executable, "-c", program]
        ran = subprocess.run(
            typed, env=environment(ZARM_CONNECT=started.endpoint), capture_output=True, text=True, timeout=PATIENCE
        )
        assert ran.returncode == 0, ran.stderr


def _edit(folder: Path, arguments: list[str]) -> None:
    """Serve the page until it is there, and end it."""
    with Command(*arguments, "--listen", f"127.0.0.1:{free_port()}", folder=folder) as serving:
        serving.wait_for("http://")
        serving.interrupt()
        assert serving.end() == 0


def _zenoh(arguments: list[str], endpoint: str) -> str:
    """What the zenoh command line prints."""
    program = str(Path(sys.executable).with_name("zenoh"))
    words = [program, *(endpoint if word == ENDPOINT else word for word in arguments)]
    done = subprocess.run(words, env=os.environ, capture_output=True, text=True, timeout=PATIENCE)
    assert done.returncode == 0, f"{arguments}: {done.stderr}"
    return done.stdout


def sentences() -> list[str]:
    """What the first column of the table of faults quotes, piece by piece."""
    table = section(COMMISSIONING, "When something does not work").splitlines()
    rows = [line for line in table if line.startswith("| ")]
    return [piece for row in rows[1:] for piece in re.findall(r"`([^`]+)`", row.split(" | ")[0])]


def test_the_table_quotes_what_zarm_says() -> None:
    sources = "".join(
        path.read_text() for folder in ("libs", "services") for path in sorted((ROOT / folder).rglob("*.py"))
    )
    joined = re.sub(r'"\s*\n\s*f?"', "", sources)
    system = {"No space left on device", "zarm status --json"}
    missing = [text for text in sentences() if text not in joined and text not in system]
    assert missing == []
    assert len(sentences()) > 25
