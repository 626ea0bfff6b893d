"""Prints LICENCES.md: every package in the images, its version and its licence. `make licences` runs it.

Reads the JSON of pip-licenses, over the environment in which the packages are installed, from standard input.
"""

from __future__ import annotations

import json
import re
import sys
from importlib.metadata import distribution
from pathlib import Path

from catkin_pkg.package import parse_package

REQUIREMENTS = Path(__file__).parent / "requirements"
IMAGES = {"executor": "all", "planner": "planner", "ros_bridge": "ROS bridge, simulated driver", "viewer": "viewer"}

READ = {"ros-fastcdr": "Apache-2.0", "ros-fastrtps": "Apache-2.0"}
"""Read in the licence files of packages that state theirs nowhere else."""

HEADER = """\
# Licences of the packages in the images

Written by `make licences` from what each package states. zarm itself is under Apache-2.0, as are its own `curobo_msgs`.

No package is under the GPL or a similar licence. certifi and tqdm are under MPL-2.0, and are shipped unchanged; eclipse-zenoh may be used
under either of its two licences. Some wheels contain libraries under other licences, all of them loaded as libraries: numpy and scipy
OpenBLAS (BSD), libgfortran (GPL with GCC's runtime library exception, for programs of any licence) and libquadmath (LGPL); pillow
image libraries (permissive licences); ROS OpenSSL 1.1.1 (its own licence), lttng-ust and liburcu (LGPL). Debian packages, some under
the GPL, are shipped unchanged, with their licences in `/usr/share/doc/*/copyright` of each image.

| package | version | licence | image |
|---|---|---|---|
"""


def installed() -> dict[str, tuple[str, str]]:
    """The version and the image of each package, by its name."""
    packages: dict[str, tuple[str, str]] = {}
    for file, image in IMAGES.items():
        for name, version in re.findall(r"^([\w.-]+)==(\S+)", (REQUIREMENTS / f"{file}.txt").read_text(), re.MULTILINE):
            packages.setdefault(name, (version, image))
    return packages


def stated_to_ros(name: str) -> str:
    """The licence that a package of ROS states in its package.xml, which is all that its wheel says of it."""
    name = name.replace("ros-jazzy-", "ros-")  # an empty package that brings the one of that name
    for file in distribution(name).files or []:
        if file.name == "package.xml":
            return " AND ".join(parse_package(str(file.locate())).licenses)
    return READ.get(name, "UNKNOWN")


def main() -> None:
    """Print the table."""
    stated = {row["Name"].lower().replace("_", "-"): row["License"] for row in json.load(sys.stdin)}
    rows = []
    for name, (version, image) in sorted(installed().items()):
        licence = stated[name] if stated[name] != "UNKNOWN" else stated_to_ros(name)
        rows.append(f"| {name} | {version} | {licence} | {image} |\n")
    sys.stdout.write(HEADER + "".join(rows))


if __name__ == "__main__":
    main()
