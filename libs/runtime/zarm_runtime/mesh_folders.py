"""The folders in which a service looks for mesh files of the scene."""

from __future__ import annotations

import argparse
import os
from pathlib import Path


def add_meshes(parser: argparse.ArgumentParser) -> None:
    """Add the folders of the scene's meshes to a command line, as `options.meshes`: those of `$ZARM_MESHES` and
    `--meshes`.
    """
    parser.add_argument(
        "--meshes",
        type=Path,
        action="append",
        default=[Path(folder) for folder in os.environ.get("ZARM_MESHES", "").split(os.pathsep) if folder],
        metavar="FOLDER",
        help="a folder whose mesh files the scene may use, besides those in $ZARM_MESHES, the same for planner, servo and viewer; repeatable",
    )
