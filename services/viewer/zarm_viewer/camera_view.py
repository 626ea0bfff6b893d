"""The cameras in the 3D view: where each is, what it looks at, and its newest depth image."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from viser import CameraFrustumHandle, SceneNodeHandle

from zarm_contract.errors import InvalidRequest
from zarm_contract.image import decode_image
from zarm_contract.messages import Camera, Cameras
from zarm_viewer.panel_context import PanelContext

LINES, UNKNOWN = (116, 143, 252), (40, 44, 60)
"""Colours of the frustum, and of a pixel without a depth."""
_SCALE = 0.15
"""Length (m) of a frustum."""
_WIDEST = 160
"""Most pixels of an image in a row on the page."""


class CameraView:
    """Draws the cameras of one robot. `nodes` are those of its links, which carry them."""

    def __init__(self, panels: PanelContext, nodes: Mapping[str, str]) -> None:
        self._panels, self._nodes = panels, nodes
        self._drawn: dict[str, tuple[Camera, SceneNodeHandle]] = {}

    def draw(self, cameras: Cameras) -> None:
        """Show these cameras."""
        wanted = {camera.name: camera for camera in cameras.cameras}
        for name in [name for name, (camera, _) in self._drawn.items() if wanted.get(name) != camera]:
            self._drawn.pop(name)[1].remove()
        for name, camera in wanted.items():
            if name not in self._drawn:
                self._drawn[name] = camera, self._add(camera)

    def draw_images(self, images: Mapping[str, bytes]) -> None:
        """Show the newest depth images, by camera and as they are on the bus."""
        for name, payload in images.items():
            camera, handle = self._drawn.get(name, (None, None))
            if camera is not None and isinstance(handle, CameraFrustumHandle):
                try:
                    handle.image = shaded(payload, camera)
                except InvalidRequest:  # the perception says what is wrong with it
                    handle.image = None

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


def shaded(payload: bytes, camera: Camera) -> NDArray[np.uint8]:
    """A depth image as grey levels (h, w, 3), light where it is near. Raises InvalidRequest for one that cannot be read."""
    header, pixels = decode_image(payload)
    kind, unit = ("<u2", 0.001) if header.encoding == "16UC1" else ("<f4", 1.0)
    step = -(-header.width // _WIDEST)
    depth = unit * np.frombuffer(pixels, kind).reshape(header.height, header.width)[::step, ::step].astype(float)
    known = depth > 0.0  # not NaN
    share = np.clip((np.where(known, depth, camera.far) - camera.near) / max(camera.far - camera.near, 1e-6), 0.0, 1.0)
    levels = np.rint(235.0 - 205.0 * share).astype(np.uint8)
    return np.where(known[..., None], levels[..., None], np.array(UNKNOWN, np.uint8))
