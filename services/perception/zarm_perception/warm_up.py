"""Compiles the kernels of the voxel map, or loads them from the cache.

Run `python -m zarm_perception.warm_up` after an installation, so that no service has to compile them.
"""

from __future__ import annotations

import sys

import numpy as np

from zarm_perception.kernels.integration import View, project
from zarm_perception.voxel_map import RobotShape, VoxelMap


def warm_up() -> None:
    """Take an image and a cloud of nothing."""
    view = View(100.0, 100.0, 15.5, 15.5, np.eye(3), np.zeros(3), 0.1, 2.0)
    voxels = VoxelMap(np.zeros(3), np.ones(3), 0.1)
    part = np.zeros((1, 17))
    image = np.ones((32, 32), np.float32)
    project(np.ones((1, 3), np.float32), view, image)
    voxels.integrate(image, view, RobotShape(part, np.zeros((1, 4))), 0.0)


def main() -> int:
    """Compile all kernels."""
    warm_up()
    return 0


if __name__ == "__main__":
    sys.exit(main())
