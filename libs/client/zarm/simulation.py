"""The simulation with physics that stands in for a robot: its world, and what really happens there."""

from __future__ import annotations

from pathlib import Path

from zarm.calls import Calls
from zarm.scene import EDIT_SECONDS
from zarm.values import made
from zarm_contract.errors import Unavailable
from zarm_contract.messages import DynamicObject, LoadScene, LoadWorld, PhysicsState, SceneEdit, SceneObject

_SILENCE = 5.0
"""s without a state after which no simulation runs."""


class Simulation(Calls):
    """The simulation of a robot that runs with `zarm up --driver physics`."""

    def load(self, world: str | Path, *, scene: bool = True) -> int:
        """Replace the world by one that comes with zarm, or by a YAML file; also in the `scene`, without what moves by
        itself. Returns how many objects it has.

        Raises InvalidRequest that names the file, the line and the fault, and Unavailable if no simulation runs.
        """
        from zarm_contract.world import load_world

        loaded = load_world(str(world))
        self._ask(self._keys.physics_world, loaded, timeout=EDIT_SECONDS)
        if scene:
            walking = {name for group in loaded.moving for name in group.names}
            standing = tuple(item for item in loaded.objects if item.name not in walking)
            edit = SceneEdit(edit=LoadScene(op="load", objects=standing))
            self._ask(self._keys.scene_edit, edit, timeout=EDIT_SECONDS)
        return len(loaded.objects)

    def add(self, *objects: SceneObject, mass: float | None = None, friction: float = 1.0) -> None:
        """Add objects to the world; what is there stays where it is. With a `mass` (kg) each of them falls and can be pushed, else it is fixed.

        Raises InvalidRequest for a name that is there already, and Unavailable if no simulation runs.
        """
        falling = (
            ()
            if mass is None
            else tuple(made(DynamicObject, name=item.name, mass=mass, friction=friction) for item in objects)
        )
        self._ask(self._keys.physics_world, LoadWorld(objects=objects, dynamic=falling, add=True), timeout=EDIT_SECONDS)

    def state(self) -> PhysicsState:
        """What really happens at this moment. Raises Unavailable if no simulation runs."""
        state = self.connection.next(self._keys.physics_state, _SILENCE)
        if state is None:
            raise Unavailable("no simulation with physics says what happens; start one with `zarm up --driver physics`")
        return state
