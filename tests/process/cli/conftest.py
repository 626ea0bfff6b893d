"""The commands share a `zarm up`."""

from support.shared_up import empty_scene, observer, place, up

__all__ = ["empty_scene", "observer", "place", "up"]
