"""The number of examples of a property: a share of the profile's, so that one option of pytest changes all of them."""

from __future__ import annotations

from typing import Any

from hypothesis import settings


def examples(share: float, **others: Any) -> settings:
    """The profile's number times `share`: less for a property whose examples are slow; other settings too."""
    return settings(max_examples=max(1, round(share * settings.default.max_examples)), **others)
