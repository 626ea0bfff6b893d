"""A headless browser: Debian's Chromium, with software rendering."""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from playwright.sync_api import Browser, sync_playwright

CHROMIUM = shutil.which("chromium")
EYE, LOOK_AT, FIELD = (1.65, -1.0, 1.2), (0.35, 0.15, 0.45), math.radians(75)
"""The page's initial camera (m, vertical field of view in rad); `zarm_viewer.kept_margin` sets the first two, viser the last.
"""
_ARGUMENTS = (
    "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
)  # fmt: skip


@contextmanager
def browser() -> Iterator[Browser]:
    """Chromium, until the block ends."""
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=list(_ARGUMENTS))
        try:
            yield chromium
        finally:
            chromium.close()


def pixel(point: tuple[float, ...], width: int, height: int) -> tuple[float, float]:
    """The pixel of a scene point (m) on a page of this size with the initial camera."""
    eye, at, seen = (np.array(vector, dtype=float) for vector in (EYE, LOOK_AT, point))
    ahead = (at - eye) / np.linalg.norm(at - eye)
    right = np.cross(ahead, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    away = seen - eye
    scale = height / 2 / math.tan(FIELD / 2) / float(away @ ahead)
    return width / 2 + scale * float(away @ right), height / 2 - scale * float(away @ np.cross(right, ahead))
