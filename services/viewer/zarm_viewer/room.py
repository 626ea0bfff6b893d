"""The room that robots stand in: light, floor, background, and where one looks from at first."""

from __future__ import annotations

import numpy as np
import viser

BESIDE = 2.5
"""Robots stand so many m apart in the picture, along y: the bus does not say where their bases are."""
BACKGROUND = (226, 232, 240)


def furnish(server: viser.ViserServer, robots: int) -> None:
    """Light, a floor, and a camera that sees `robots` of them beside each other."""
    scene, gui = server.scene, server.gui
    scene.set_up_direction("+z")
    scene.configure_environment_map(hdri=None)  # reflections would cost a machine without a GPU a second for each frame
    scene.configure_default_lights(cast_shadow=False)
    scene.add_light_ambient("/light", intensity=0.7)
    scene.set_background_image(np.full((1, 1, 3), BACKGROUND, dtype=np.uint8), format="png")
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
    gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")
