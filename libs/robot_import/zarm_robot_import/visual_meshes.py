"""Chooses visual meshes used besides the collision geometry: not those that would keep two links from separating."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

from zarm_robot_import.contacts import Contacts
from zarm_robot_import.meshes import Surface

MOST_TAKEN = 0.3
"""Largest share of all configurations that visual meshes may block for a pair of links."""
_CROWD = 300
"""Number of configurations examined."""


def without_contradictions(surfaces: Sequence[Surface], contacts: Contacts) -> list[Surface]:
    """The surfaces, some with their collision geometry alone.

    If two links touch with their visual meshes in many more configurations than with their collision geometry alone,
    the arm could hardly move: the visual mesh responsible is left out, with that reason. If the collision geometry
    never touches but the visual one always does, like a cable along the arm, nothing is lost: the pair is ignored
    later.
    """
    bare: dict[str, str] = {}
    for first, second in combinations([surface.link for surface in surfaces], 2):
        mixed = contacts.mixed(first, second)
        if not mixed or abs(contacts.body[first] - contacts.body[second]) < 2:
            continue
        whole = contacts.share(first, second, _CROWD)
        if whole <= MOST_TAKEN:
            continue
        alone = contacts.share(first, second, _CROWD, mixed)
        if whole - alone <= MOST_TAKEN or (whole == 1.0 and alone == 0.0):
            continue
        left = {link: contacts.share(first, second, _CROWD, [link]) - alone for link in mixed}
        least = min(left, key=lambda link: left[link])
        for link in [least] if left[least] <= MOST_TAKEN else mixed:
            other = second if link == first else first
            bare[link] = (
                f"with it {link} and {other} touch in {whole:.0%} of all configurations, and without it in {alone:.0%}"
            )
            contacts.drop_visual(link)
    return [surface.without_visual(bare[surface.link]) if surface.link in bare else surface for surface in surfaces]
