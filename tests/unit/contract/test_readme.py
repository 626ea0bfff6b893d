"""The README of the contract lists what there is."""

from __future__ import annotations

import re
from typing import get_args

import pytest

from support.paths import ROOT
from zarm_contract.errors import Code
from zarm_contract.keys import Keys

README = ROOT / "libs" / "contract" / "README.md"


def first_column(heading: str) -> list[str]:
    """Every `name` in the first column of the tables under a heading."""
    section = README.read_text().split(f"\n## {heading}\n")[1].split("\n## ")[0]
    cells = [line.split("|")[1] for line in section.splitlines() if line.startswith("| `")]
    return [name for cell in cells for name in re.findall(r"`([^`]+)`", cell)]


def test_every_key_is_listed_once() -> None:
    keys = Keys("arm")
    every = {getattr(keys, name) for name, value in vars(Keys).items() if isinstance(value, property)}
    every |= {keys.scene_object("<name>"), keys.goal("<goal_id>")}
    every |= {keys.health("<service>"), keys.reread("<service>"), keys.alive("<service>", "<instance>")}
    assert sorted(f"zarm/arm/{key}" for key in first_column("Keys")) == sorted(every)


def test_every_problem_code_is_listed_once() -> None:
    assert sorted(first_column("Problems")) == sorted(get_args(Code))


@pytest.mark.parametrize("package", ["service.py", "logs.py"])
def test_every_setting_that_is_read_is_listed(package: str) -> None:
    source = (README.parents[1] / "runtime" / "zarm_runtime" / package).read_text()
    assert set(re.findall(r'"(ZARM_[A-Z]+)"', source)) <= set(first_column("Settings"))
