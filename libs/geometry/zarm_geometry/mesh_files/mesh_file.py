"""What a mesh file holds."""

from __future__ import annotations

from dataclasses import dataclass

from zarm_trajectory.arrays import Array


@dataclass(frozen=True)
class MeshFile:
    """The triangles (n, 3, 3) of a file, in its frame, wound as in the file; in m if the format or the file states its unit.

    `notes` are sentences about what the file holds and the triangles do not.
    """

    triangles: Array
    notes: tuple[str, ...] = ()


class Unreadable(Exception):
    """A file, or a part of it, that cannot be read; the text names the place and the remedy."""


def accounted(what: str, held: int, built: int) -> None:
    """Raise Unreadable unless all that a file holds was built."""
    if held != built:
        raise Unreadable(f"of {held} {what}, {built} were read; convert it to another format, and report this file")


def many(count: int, one: str, more: str = "") -> str:
    """`1 face`, `2 faces`."""
    return f"{count} {one if count == 1 else more or one + 's'}"
