"""A publisher of wrong joint states on a robot's key."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from support.faults.arena import STEP, Arena
from support.trajectories import HOME
from zarm_runtime.session import open_client

Told = Callable[[np.ndarray, dict[str, object]], dict[str, object]]
"""From the arm's trace so far and its true joint state, the one to publish instead."""


@contextmanager
def impostor(place: Arena, tell: Told) -> Iterator[None]:
    """Publish this, as often as the driver does."""
    ended = threading.Event()

    def run() -> None:
        with open_client(place.endpoint) as session:
            while not ended.wait(STEP):
                trace = place.trace()
                session.put(place.keys.driver_joint_states, json.dumps(tell(trace, state(place, trace[-1]))))

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def state(place: Arena, row: np.ndarray) -> dict[str, object]:
    """A row of the trace as a joint state measured now."""
    position, velocity = row[: len(HOME)].tolist(), row[len(HOME) :].tolist()
    return {"stamp": time.time(), "joint_names": place.joints, "position": position, "velocity": velocity}
