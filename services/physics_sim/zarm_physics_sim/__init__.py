"""A robot with mass. MuJoCo chooses how it renders when it is imported: without a screen, if there is a way."""

import os
from ctypes.util import find_library

_BACKENDS = {"egl": "EGL", "osmesa": "OSMesa"}

if "MUJOCO_GL" not in os.environ:
    os.environ["MUJOCO_GL"] = next((way for way, library in _BACKENDS.items() if find_library(library)), "disable")
