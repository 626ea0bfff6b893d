"""The README of each library and service has a map of its modules, and nothing is missing from it."""

from __future__ import annotations

import re
from fnmatch import fnmatch
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
PACKAGES = sorted(
    path.parent for path in (*ROOT.glob("libs/*/zarm*/__init__.py"), *ROOT.glob("services/*/zarm*/__init__.py"))
)


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.name)
def test_the_map_of_a_package_names_each_of_its_modules(package: Path) -> None:
    first_cells = re.findall(r"^\| (`.*?) \|", (package.parent / "README.md").read_text(), re.M)
    named = {name.rstrip("/") for cell in first_cells for name in re.findall(r"`([^`]+)`", cell)}
    modules = {path.stem for path in package.iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()}
    public = sorted(name for name in modules if not name.startswith("_"))
    assert [name for name in public if not any(fnmatch(name, pattern) for pattern in named)] == []
