"""The room around the robots: light, floor, and the first camera position."""

from __future__ import annotations

import numpy as np
import viser
from viser import ClientHandle

from zarm_viewer.style import dress

BESIDE = 2.5
"""Distance (m) between robots in the view, along y: the bus does not report where their bases are."""
PANEL = 384
"""Width (px) of the panels beside the view."""
PORTRAIT, TABLET = 0.7, 1000
"""A page narrower than this share of its height is upright, and that of a phone if it is less than this high (px)."""
LOWER, AWAY = 0.6, 2.0
"""On a phone the camera looks this much (m) lower, because panels cover the lower half; on another upright page it is
this many times as far away, because they leave a narrow view.
"""


def add_environment(server: viser.ViserServer, robots: int) -> None:
    """Light, a floor, and a camera that shows `robots` of them side by side."""
    scene, gui = server.scene, server.gui
    dress(gui)
    scene.set_up_direction("+z")
    scene.configure_environment_map(hdri=None)  # reflections would cost a machine without a GPU a second per frame
    scene.configure_default_lights(cast_shadow=False)
    scene.add_light_ambient("/light", intensity=0.7)
    across = BESIDE * (robots - 1)
    scene.add_grid(
        "/floor",
        width=4.0,
        height=4.0 + across,
        position=(0.0, across / 2, 0.0),
        cell_size=0.5,
        section_size=1.0,
        plane="xy",
    )
    camera, away = server.initial_camera, 1.3 * across
    camera.position = (1.45 + away, -0.82 - across / 4, 1.08 + away / 2)
    camera.look_at = (0.35, 0.15 + across / 2, 0.45)
    gui.configure_theme(show_logo=False, show_share_button=False)
    gui.main_panel.dock_right()  # beside the view, so that it covers no robot
    gui.main_panel.set_width(PANEL)  # a page that docks the panel before it reads the theme loses that width

    @server.on_client_connect
    def _(client: ClientHandle) -> None:
        if client.camera.aspect < PORTRAIT:
            at = np.array(camera.look_at)
            if client.camera.image_height < TABLET:
                client.camera.look_at = at - (0.0, 0.0, LOWER)
            else:
                client.camera.position = at + AWAY * (np.array(camera.position) - at)
                client.camera.look_at = at  # which moves with the position
