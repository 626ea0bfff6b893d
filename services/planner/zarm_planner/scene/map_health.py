"""Whether the cameras of the voxel map see."""

from __future__ import annotations

from zarm_contract.errors import Unavailable
from zarm_contract.messages import PerceptionState
from zarm_runtime import clock

STALE_SCALE = 0.1
"""Scale of velocity and acceleration of plans in a stale map, for a robot that is to be slow in it."""
_SILENCE = 3.0
"""s without a state after which the perception counts as gone."""


class MapHealth:
    """The newest state of the perception. Without one there are no cameras, and all is well."""

    def __init__(self) -> None:
        self._newest: tuple[PerceptionState, float] | None = None

    def receive(self, _key: str, state: PerceptionState) -> None:
        """Take a state."""
        self._newest = state, clock.monotonic()

    @property
    def problem(self) -> str | None:
        """Why the map is stale, None if it is not."""
        if self._newest is None:
            return None
        state, arrived = self._newest
        silent = clock.monotonic() - arrived
        if silent > _SILENCE:
            return f"the perception has said nothing for {silent:.1f} s; start it again"
        if state.stale:
            blind = "; ".join(f"{camera.name}: {camera.problem}" for camera in state.cameras if camera.problem)
            return f"{blind or 'a camera does not see'}; mend the camera, remove it (`zarm sensor remove`)"
        return None

    def check(self) -> None:
        """Raises Unavailable while a camera does not see, or the perception has gone."""
        if (problem := self.problem) is not None:
            raise Unavailable(
                f"the voxel map is stale: {problem}, or let the descriptor slow down or ignore it (`stale_map`)"
            )
