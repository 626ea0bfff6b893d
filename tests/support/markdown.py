"""The commands that the documentation tells users to type, in the shell blocks of its pages."""

from __future__ import annotations

import re
import shlex

from support.paths import ROOT

PAGES = sorted(
    path
    for path in (
        *ROOT.glob("*.md"),
        *(path for folder in ("docs", "deploy", "services") for path in (ROOT / folder).rglob("*.md")),
    )
    if path.name != "CHANGELOG.md"
)
"""Every page for users."""


def section(text: str, heading: str) -> str:
    """The text under a heading of the second level."""
    return text.split(f"\n## {heading}\n", 1)[1].split("\n## ", 1)[0]


def shell_blocks(text: str) -> list[str]:
    """The content of each `sh` block."""
    return re.findall(r"```sh\n(.*?)```", text, re.DOTALL)


def python_blocks(text: str) -> list[str]:
    """The content of each `python` block."""
    return re.findall(r"```python\n(.*?)```", text, re.DOTALL)


def commands(text: str, *programs: str) -> list[list[str]]:
    """Every command of these programs in the shell blocks of a text, as words; a line that ends in a backslash
    continues.
    """
    lines = [line.strip() for block in shell_blocks(text) for line in block.replace("\\\n", " ").splitlines()]
    return [shlex.split(line, comments=True) for line in lines if line.split(" ", 1)[0] in programs]
