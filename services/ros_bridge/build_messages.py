"""Builds the messages of the ROS bridge into this interpreter's virtual environment, against the ROS packages that pip installed.

These are a generation of curobo_msgs, and the packages of MoveIt, ros2_control and tf2 that are not on PyPI. `make ros` runs this.
Where ROS itself is installed, `colcon build` builds curobo_msgs, and the others come with ROS.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import sysconfig
from importlib.util import find_spec
from pathlib import Path

PACKAGE = "curobo_msgs"
DEFINITIONS = Path(__file__).parent / "zarm_ros_bridge" / "curobo" / "generations" / PACKAGE
OTHERS = Path(__file__).parent / "zarm_ros_bridge" / "interfaces"
"""The other packages, a folder each."""
PYTHON_HEADER = Path(sysconfig.get_path("include"), "Python.h")


def missing_tools() -> list[str]:
    """What the build needs but cannot find."""
    found = {
        "a C compiler (cc)": shutil.which("cc"),
        "a C++ compiler (c++)": shutil.which("c++"),
        f"the headers of Python ({PYTHON_HEADER})": PYTHON_HEADER.exists(),
        "the ROS packages (pip install 'zarm[ros,ros-messages]')": find_spec("rosidl_generator_py"),
    }
    return [tool for tool, there in found.items() if not there]


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("generation", nargs="?", default="b", choices=("a", "b", "c"), help="default: b")
    parser.add_argument("--into", type=Path, default=Path(sys.prefix), help="the prefix to install into")
    parser.add_argument("--cache", type=Path, default=Path(sys.prefix, ".messages"), help="what was built before")
    parser.add_argument(
        "--with",
        dest="others",
        metavar="PACKAGE",
        type=Path,
        nargs="*",
        default=(),
        help="folders of other packages with definitions, as nav2_msgs, to be built as well",
    )
    return parser.parse_args()


def _say(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def main() -> None:
    """Build, or exit with a one-sentence reason."""
    arguments = _arguments()
    if missing := missing_tools():
        sys.exit(
            f"The ROS bridge is left out: building its messages needs {', '.join(missing)}. All else works without; "
            "for the bridge install it (on Debian: apt-get install build-essential python3-dev) and run `make ros`."
        )
    from interface_package import KINDS, Definition, build, install  # needs the ROS packages

    generation: str = arguments.generation
    sources = [(PACKAGE, folder) for folder in DEFINITIONS.iterdir() if folder.is_dir() and generation in folder.name]
    sources += [(folder.resolve().name, folder.resolve()) for folder in (*sorted(OTHERS.iterdir()), *arguments.others)]
    definitions = [
        Definition(package, path)
        for package, folder in sources
        for path in sorted(folder.glob("*/*"))
        if path.suffix in KINDS
    ]
    title = f"messages, {PACKAGE} of generation {generation.upper()}"
    try:
        tree, left_out = build(
            definitions,
            arguments.cache,
            lambda done, total, name: _say(f"{title}: built {done} of {total} ({name})"),
        )
    except subprocess.CalledProcessError as failed:
        sys.exit(f"{failed.stdout[-6000:]}\nThe ROS bridge is left out: its messages did not build; see above.")
    for name, lacking in left_out.items():
        _say(f"{title}: {name} is left out, because {lacking} is not installed here")
    for package in dict.fromkeys(package for package, _ in sources):
        if (tree / "share" / package).exists():
            install(package, tree, arguments.into)
    _say(f"{title}: installed into {arguments.into}")


if __name__ == "__main__":
    main()
