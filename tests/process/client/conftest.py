"""The programs share a `zarm up`."""

from support.shared_up import empty_scene, observer, up

__all__ = ["empty_scene", "observer", "up"]
