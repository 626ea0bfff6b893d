"""Builds curobo_msgs into this interpreter's virtual environment, against the ROS packages that pip installed there.

`make ros` runs this. Where ROS itself is installed, `colcon build` does the same from the same directory.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

HERE = Path(__file__).parent
PREFIX = Path(sys.prefix)
CMAKE = PREFIX / "bin" / "cmake"
PYTHON_HEADER = Path(sysconfig.get_path("include"), "Python.h")


def missing_tools() -> list[str]:
    """What the build needs and does not find."""
    found = {
        "a C compiler (cc)": shutil.which("cc"),
        "a C++ compiler (c++)": shutil.which("c++"),
        "make": shutil.which("make"),
        f"the headers of Python ({PYTHON_HEADER})": PYTHON_HEADER.exists(),
        f"{CMAKE} and the ROS packages (pip install 'zarm[ros,ros-messages]')": CMAKE.exists(),
    }
    return [tool for tool, there in found.items() if not there]


def build(directory: str) -> None:
    """Build in `directory` and install into the environment; raises CalledProcessError."""
    options = {
        "CMAKE_BUILD_TYPE": "Release",
        "CMAKE_INSTALL_MESSAGE": "NEVER",
        "CMAKE_INSTALL_PREFIX": PREFIX,
        "CMAKE_PREFIX_PATH": PREFIX,
        "CMAKE_PROJECT_INCLUDE": HERE / "pypi_wheels.cmake",
        "Python3_EXECUTABLE": sys.executable,
    }
    for command in (
        [CMAKE, "-S", HERE / "curobo_msgs", "-B", directory, *(f"-D{name}={value}" for name, value in options.items())],
        [CMAKE, "--build", directory, "--parallel", str(os.cpu_count())],
        [CMAKE, "--install", directory],
    ):
        subprocess.run(  # noqa: S603  our own words alone
            command, check=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )


def main() -> None:
    """Build, or end with one sentence that says why not."""
    if missing := missing_tools():
        sys.exit(
            f"The ROS bridge is left out: building its messages needs {', '.join(missing)}. All else works without; "
            "for the bridge install it (on Debian: apt-get install build-essential python3-dev) and run `make ros`."
        )
    with tempfile.TemporaryDirectory(prefix="curobo_msgs-") as directory:
        try:
            build(directory)
        except subprocess.CalledProcessError as failed:
            sys.exit(f"{failed.stdout[-6000:]}\nThe ROS bridge is left out: its messages did not build; see above.")


if __name__ == "__main__":
    main()
