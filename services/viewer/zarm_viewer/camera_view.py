"""The cameras in the 3D view: where each is, what it looks at, and its newest depth image with what the map leaves out."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray
from viser import CameraFrustumHandle, SceneNodeHandle

from zarm_contract.errors import InvalidRequest
from zarm_contract.image import COUNTS, OF_ROBOT, decode_color, decode_image, mask_step
from zarm_contract.messages import Camera, Cameras, Intrinsics
from zarm_trajectory.arrays import Array
from zarm_viewer.panel_context import PanelContext

LINES, UNKNOWN = (116, 143, 252), (40, 44, 60)
"""Colours of the frustum, and of a pixel without a depth."""
POINTS, ROBOT, NOISE = (190, 200, 215), (240, 101, 149), (90, 95, 110)
"""Colours of points that are in the map, of the robot, which is left out, and of noise, which is too."""
_SCALE = 0.15
"""Length (m) of a frustum."""
_POINT_STEP = 2
"""Of so many pixels of a mask, in a row and in a column, one is a point."""


class CameraView:
    """Draws the cameras of one robot. `nodes` are those of its links, which carry them."""

    def __init__(self, panels: PanelContext, nodes: Mapping[str, str]) -> None:
        self._panels, self._nodes = panels, nodes
        self._drawn: dict[str, tuple[Camera, SceneNodeHandle]] = {}
        self._masks: dict[str, NDArray[np.uint8]] = {}

    def draw(self, cameras: Cameras) -> None:
        """Show these cameras."""
        wanted = {camera.name: camera for camera in cameras.cameras}
        for name in [name for name, (camera, _) in self._drawn.items() if wanted.get(name) != camera]:
            self._drawn.pop(name)[1].remove()
        for name, camera in wanted.items():
            if name not in self._drawn:
                self._drawn[name] = camera, self._add(camera)

    def draw_images(self, images: Mapping[str, bytes], masks: Mapping[str, bytes]) -> None:
        """Show the newest depth images, and what the map makes of them, by camera and as they are on the bus."""
        for name, payload in masks.items():
            with suppress(InvalidRequest):  # of another version
                header, pixels = decode_color(payload)
                self._masks[name] = np.frombuffer(pixels, np.uint8).reshape(header.height, header.width)
        for name, payload in images.items():
            camera, handle = self._drawn.get(name, (None, None))
            if camera is not None and camera.intrinsics is not None and isinstance(handle, CameraFrustumHandle):
                try:
                    depth = thinned(payload)
                except InvalidRequest:  # the perception says what is wrong with it
                    handle.image = None
                    continue
                mask = self._masks.get(name)
                if mask is None or mask.shape != depth.shape:
                    mask = np.full(depth.shape, COUNTS, np.uint8)
                handle.image = shaded(depth, mask, camera)
                fewer = np.s_[::_POINT_STEP, ::_POINT_STEP]
                points, colours = cloud(
                    depth[fewer],
                    mask[fewer],
                    camera.intrinsics,
                    camera.far,
                    _POINT_STEP * mask_step(camera.intrinsics.width),
                )
                self._panels.server.scene.add_point_cloud(
                    f"{handle.name}/points", points, colours, point_size=0.004, precision="float32"
                )

    def _add(self, camera: Camera) -> SceneNodeHandle:
        api, size = self._panels.server.scene, camera.intrinsics
        link = camera.link or self._panels.description.descriptor.base_link
        node = f"{self._nodes.get(link, self._panels.root)}/camera_{camera.name}"
        x, y, z, w = camera.orientation
        if size is None or camera.projection == "spherical":
            return api.add_frame(
                node, axes_length=_SCALE, axes_radius=0.004, wxyz=(w, x, y, z), position=camera.position
            )
        return api.add_camera_frustum(
            node,
            fov=2.0 * math.atan(0.5 * size.height / size.fy),
            aspect=(size.width / size.fx) / (size.height / size.fy),
            scale=_SCALE,
            thickness=0.003,
            color=LINES,
            wxyz=(w, x, y, z),
            position=camera.position,
        )


def thinned(payload: bytes) -> Array:
    """The depths (h, w) in m of an image on the bus, thinned out as its mask; 0 or NaN where there is none. Raises InvalidRequest for one that cannot be read."""
    header, pixels = decode_image(payload)
    kind, unit = ("<u2", 0.001) if header.encoding == "16UC1" else ("<f4", 1.0)
    step = mask_step(header.width)
    depth = np.frombuffer(pixels, kind).reshape(header.height, header.width)[::step, ::step]
    return np.asarray(unit * depth.astype(float))


def shaded(depth: Array, mask: NDArray[np.uint8], camera: Camera) -> NDArray[np.uint8]:
    """Depths (h, w) as grey levels (h, w, 3), light where it is near; the robot is coloured."""
    known = depth > 0.0  # not NaN
    share = np.clip((np.where(known, depth, camera.far) - camera.near) / max(camera.far - camera.near, 1e-6), 0.0, 1.0)
    levels = np.rint(235.0 - 205.0 * share).astype(np.uint8)[..., None]
    grey = np.where(known[..., None], levels, np.array(UNKNOWN, np.uint8))
    tinted = (levels // 2 + np.array(ROBOT, np.uint8) // 2).astype(np.uint8)
    return np.where((mask == OF_ROBOT)[..., None], tinted, grey)


def cloud(
    depth: Array, mask: NDArray[np.uint8], size: Intrinsics, far: float, step: int
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """The points (n, 3) of depths (h, w) up to `far` (m), in the frame of the camera, and their colours (n, 3). The depths are those of every `step`-th pixel."""
    rows, columns = np.nonzero((depth > 0.0) & (depth <= far))
    z = depth[rows, columns]
    x, y = (columns * step - size.cx) / size.fx * z, (rows * step - size.cy) / size.fy * z
    kinds = mask[rows, columns]
    colours = np.select(
        [(kinds == COUNTS)[:, None], (kinds == OF_ROBOT)[:, None]], [np.array(POINTS), np.array(ROBOT)], np.array(NOISE)
    )
    return np.column_stack((x, y, z)).astype(np.float32), colours.astype(np.uint8)
