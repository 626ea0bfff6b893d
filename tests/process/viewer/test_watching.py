"""What the page reads of a simulation on a live bus."""

from __future__ import annotations

import zarm
from support.harness import eventually
from zarm_contract.keys import Keys
from zarm_contract.messages import Cuboid, PhysicsObjects, PhysicsState
from zarm_runtime.bus import Bus
from zarm_viewer.watching import News, Watching

KEYS = Keys("arm")
BOX = Cuboid(kind="cuboid", name="box", size=(0.1, 0.1, 0.1), position=(0.5, 0.0, 0.05))


def test_objects_and_state_of_a_simulation_come_to_the_page_once(endpoint: str) -> None:
    state = PhysicsState(stamp=1.0, time=1.0, real_time_factor=1.0, position=(0.0,), velocity=(0.0,), effort=(0.0,))
    with Bus(endpoint) as bus, zarm.connect(endpoint, "arm") as robot:
        bus.latched(KEYS.physics_objects).set(PhysicsObjects(objects=(BOX,)))
        watching, publisher, found = Watching(robot, lambda: ()), bus.publisher(KEYS.physics_state), list[News]()

        def came() -> bool:
            publisher.put(state)
            found.append(watching.take(("joint",)))
            return any(news.physics is not None for news in found)

        eventually(came, "the state comes")
        assert [news.simulated for news in found if news.simulated is not None] == [PhysicsObjects(objects=(BOX,))]
