"""Names are words of the field: those of a private language do not come back."""

from __future__ import annotations

import io
import keyword
import re
import tokenize
from pathlib import Path

ROOT = Path(__file__).parents[3]
PRIVATE = frozenset(
    [
        "ailment",
        "astray",
        "attend",
        "course",
        "crawls",
        "desk",
        "furnish",
        "glance",
        "halted",
        "hear",
        "hears",
        "heard",
        "obey",
        "spoken",
        "suffer",
        "tell",
        "tells",
        "told",
        "untold",
    ]
)
"""docs/explanation/glossary.md has the words that zarm uses in a sense of its own."""


def words(name: str) -> set[str]:
    """The words of an identifier: of `_told_at` and `ToldAt`, told and at."""
    return {word.lower() for word in re.split(r"_+|(?<=[a-z0-9])(?=[A-Z])", name)}


def test_no_name_has_a_private_word() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{token.start[0]}: {token.string}"
        for folder in ("libs", "services")
        for path in sorted((ROOT / folder).rglob("*.py"))
        for token in tokenize.generate_tokens(io.StringIO(path.read_text()).readline)
        if token.type == tokenize.NAME and not keyword.iskeyword(token.string) and words(token.string) & PRIVATE
    ]
    assert found == []


def test_names_of_tests_have_at_most_60_characters() -> None:
    """So that a line of pytest's output has room for it."""
    names = re.compile(r"^(?:async )?def (test_\w{56,})\(", re.MULTILINE)
    found = [
        f"{path.relative_to(ROOT)}: {name}"
        for path in sorted((ROOT / "tests").rglob("*.py"))
        for name in names.findall(path.read_text())
    ]
    assert found == []
