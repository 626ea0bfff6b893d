"""Whether the cameras of the voxel map see."""

from __future__ import annotations

import time

from zarm_contract.errors import Unavailable
from zarm_contract.messages import PerceptionState

_SILENCE = 3.0
"""s without a state after which the perception counts as gone."""


class MapHealth:
    """The newest state of the perception. Without one there are no cameras, and all is well."""

    def __init__(self) -> None:
        self._newest: tuple[PerceptionState, float] | None = None

    def receive(self, _key: str, state: PerceptionState) -> None:
        """Take a state."""
        self._newest = state, time.monotonic()

    def check(self) -> None:
        """Raises Unavailable while a camera does not see, or the perception has gone."""
        if self._newest is None:
            return
        state, arrived = self._newest
        silent = time.monotonic() - arrived
        if silent > _SILENCE:
            raise Unavailable(
                f"the voxel map is stale: the perception has said nothing for {silent:.1f} s; start it again, or let the descriptor "
                "ignore it (`stale_map: ignore`)"
            )
        if state.stale:
            blind = "; ".join(f"{camera.name}: {camera.problem}" for camera in state.cameras if camera.problem)
            raise Unavailable(
                f"the voxel map is stale: {blind or 'a camera does not see'}; mend the camera, remove it (`zarm sensor remove`), or "
                "let the descriptor ignore it (`stale_map: ignore`)"
            )
