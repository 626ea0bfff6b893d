"""The generated pages of the reference are those of the code as it is, and nothing is missing from them."""

from __future__ import annotations

import importlib.util
import os
import re
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import get_args

import pytest

from zarm_contract.errors import Code
from zarm_contract.keys import declared
from zarm_runtime.settings import SETTINGS

ROOT = Path(__file__).parents[3]
REFERENCE = ROOT / "docs" / "reference"


@pytest.fixture(scope="module")
def generate() -> Iterator[ModuleType]:
    """The script that writes the pages, with no setting of this machine's in its way."""
    spec = importlib.util.spec_from_file_location("generate", ROOT / "docs" / "generate.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    with pytest.MonkeyPatch.context() as patch:
        for name in [name for name in os.environ if name.startswith(("ZARM_", "XDG_"))]:
            patch.delenv(name)
        spec.loader.exec_module(module)
        yield module


@pytest.mark.lengthy
def test_the_pages_are_those_of_the_code(generate: ModuleType) -> None:
    made = generate.pages()
    outdated = [name for name, text in made.items() if (REFERENCE / name).read_text() != text]
    outdated += [str(page) for page, text in generate.parts().items() if page.read_text() != text]
    assert outdated == [], "run python docs/generate.py"


def test_every_key_is_on_its_page_once() -> None:
    assert sorted(_first_column("keys.md")) == sorted(key.path for key in declared().values())


def test_every_problem_code_is_on_its_page_once() -> None:
    assert sorted(_first_column("problems.md")) == sorted(get_args(Code))


def test_every_variable_that_the_code_reads_is_a_setting() -> None:
    sources = "".join(path.read_text() for folder in ("libs", "services") for path in (ROOT / folder).rglob("*.py"))
    read = set(re.findall(r'(?:environ\.get\(|getenv\(|envvar=|environ\[)\s*"(ZARM_[A-Z_]+)"', sources))
    assert read == {setting.name for setting in SETTINGS}


def _first_column(page: str) -> list[str]:
    """What stands in the first column of the tables of a page."""
    return re.findall(r"^\| `([^`]+)` \|", (REFERENCE / page).read_text(), re.MULTILINE)
