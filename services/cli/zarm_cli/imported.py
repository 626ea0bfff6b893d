"""A robot given as URDF or xacro: imported once, and again when its files or zarm change."""

from __future__ import annotations

import hashlib
import os
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from zarm_cli.output import err
from zarm_contract.errors import Unavailable
from zarm_runtime.version import version

if TYPE_CHECKING:
    from zarm_robot_import.importing import Options
    from zarm_robot_import.report import Report

_SUFFIXES = (".urdf", ".xacro", ".xml")
_CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "zarm" / "robots"


def run_import(file: Path, folder: Path, options: Options) -> tuple[Path, Report]:
    """Import with a progress bar on standard error. Raises InvalidRequest, or Unavailable without the packages."""
    importing = _importing()
    columns = (TextColumn("{task.description}", style="dim"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=err, transient=True) as bar:
        task = bar.add_task("reading", total=1.0)
        made: tuple[Path, Report] = importing.import_robot(
            file, folder, options, lambda step, share: bar.update(task, description=step, completed=share)
        )
    return made


def run_compose(file: Path, folder: Path | None, overwrite: bool) -> Path:
    """Compose a robot of several, by default into a folder of its name. Raises InvalidRequest, or Unavailable without the packages."""
    composed: Path = _importing("composing").compose(file, folder, overwrite)
    return composed


def options(**chosen: object) -> Options:
    """The options of an import. Raises Unavailable without the packages."""
    made: Options = _importing().Options(**chosen)
    return made


def descriptor_of(robot: str) -> str:
    """The descriptor of a robot given as a URDF or xacro; anything else is returned unchanged."""
    file = Path(robot)
    if file.suffix not in _SUFFIXES or not file.is_file():
        return robot
    digest = hashlib.sha256(f"{file.resolve()}{version()}".encode())
    digest.update(_importing("source").fingerprint(file))
    folder = _CACHE / digest.hexdigest()[:16]
    if not (made := next(iter(folder.glob("*.yaml")), None)):
        made, _ = run_import(file, folder, options())
        err.print(f"imported {file} to {folder}; `zarm robot import` keeps it and lets you choose", soft_wrap=True)
    return str(made)


def _importing(name: str = "importing") -> ModuleType:
    try:
        return import_module(f"zarm_robot_import.{name}")
    except ImportError as error:
        raise Unavailable(
            f"robots cannot be imported, because {error.name} cannot be imported here; `pip install 'zarm[planner,import]'`"
        ) from error
