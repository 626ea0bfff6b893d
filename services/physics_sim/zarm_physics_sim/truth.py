"""The truth of the simulation on the bus."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

from zarm_contract.messages import BodyPose, Contact, PhysicsState
from zarm_contract.messages.physics import MAX_BODIES, MAX_CONTACTS
from zarm_physics_sim.simulation import Simulation
from zarm_runtime import clock

_WINDOW = 50
"""States over which the real-time factor is measured: a second."""


class Truth:
    """Publishes what really happens."""

    def __init__(self, publish: Callable[[PhysicsState], None]) -> None:
        self._publish = publish
        self._times: deque[tuple[float, float]] = deque(maxlen=_WINDOW)

    def report(self, simulation: Simulation) -> None:
        """Publish the present state."""
        self._times.append((time.monotonic(), simulation.time))
        (began, first), (now, last) = self._times[0], self._times[-1]
        contacts = sorted(simulation.contacts(), key=lambda contact: -contact.force)[:MAX_CONTACTS]
        poses = list(simulation.poses().items())[:MAX_BODIES]
        state = PhysicsState(
            stamp=clock.unix_time(),
            time=simulation.time,
            real_time_factor=(last - first) / (now - began) if now > began else 1.0,
            position=tuple(simulation.position.tolist()),
            velocity=tuple(simulation.velocity.tolist()),
            effort=tuple(simulation.torque.tolist()),
            bodies=tuple(
                BodyPose(name=name, position=tuple(position.tolist()), orientation=tuple(orientation.tolist()))
                for name, (position, orientation) in poses
            ),
            contacts=tuple(
                Contact(
                    first=one.first,
                    second=one.second,
                    position=tuple(one.position.tolist()),
                    force=one.force,
                    normal=tuple(one.normal.tolist()),
                )
                for one in contacts
            ),
        )
        self._publish(state)
