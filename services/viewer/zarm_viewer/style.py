"""The page's style: one CSS sheet on top of viser's own. It selects buttons by their colour, since viser offers nothing
else.
"""

from __future__ import annotations

from typing import Final

from viser import GuiApi

STOP: Final = "red"
"""The colour of large buttons."""
MOVES: Final = "green"
"""The colour of buttons that move the robot."""
PAIRED: Final = "gray"
"""The colour of buttons placed side by side in pairs."""

_SHEET = f"""<style>
canvas[data-engine] {{ background: linear-gradient(#c3d0e0, #eef2f6 60%); cursor: grab !important; }}
button[style*="-{STOP}-"] {{ height: 3em !important; font-size: 1.25em !important; font-weight: 700 !important; letter-spacing: 0.1em; }}
div:has(canvas[data-engine]) {{ transition: none !important; }}
div:has(> .mantine-Button-root[style*="-{PAIRED}-"]) {{ display: inline-block; width: calc(50% - 1.5em); }}
div:has(> .mantine-Button-root[style*="-{PAIRED}-"]) > .mantine-Button-root {{ touch-action: none; user-select: none; }}
@media (max-width: 36em) {{
  button[style*="-{STOP}-"] {{ position: fixed; right: 0; bottom: 0; width: 100vw; border-radius: 0; z-index: 1000; }}
  div[style*="width: 20em"] {{ width: 100% !important; }}
  div[style*="position: fixed"][style*="width: 20em"] {{ bottom: 3.6em !important; max-height: 50% !important; }}
}}
</style>"""
"""The sky is drawn behind the canvas, which costs nothing. viser shows a pointing hand over a view that can be clicked; this one is
mostly turned. On a phone all panels are one that scrolls; it is as wide as the screen and ends above STOP, which keeps its place.
"""


def dress(gui: GuiApi) -> None:
    """Apply the style to the page."""
    gui.add_html(_SHEET)
