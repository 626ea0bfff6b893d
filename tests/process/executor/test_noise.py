"""Whatever is sent to the executor: a typed problem comes back, nothing moves, and it goes on serving."""

from __future__ import annotations

import pytest
import zenoh

from support.executor.client import Client
from support.tiers import sampled
from support.trajectories import KEYS, moved, rest_to_rest
from zarm_contract.codec import MAX_BYTES, decode
from zarm_contract.errors import InvalidRequest, Problem
from zarm_runtime.session import open_client

SHORT = rest_to_rest(moved(0.01))


NOISE = [
    b"{",
    b"\xff\xfe\x00",
    b"[]",
    b"null",
    b'"emulator"',
    b'{"unknown": 1}',
    b"[" * 100_000,
    b'{"trajectory": {"joint_names": [], "time": [0, 1e999], "position": [], "velocity": [], "acceleration": []}}',
    b'{"trajectory": {"joint_names": ["joint_1"], "time": [0, NaN], "position": [], "velocity": [], "acceleration": []}}',
    b'{"plan_id": "' + b"x" * 1000 + b'"}',
    b'{"goal_id": "../../etc"}',
    b'{"strategy": 7}',
    b" " * (MAX_BYTES + 1),
]
QUERYABLES = [
    KEYS.execute,
    KEYS.cancel,
    KEYS.stop,
    KEYS.pause,
    KEYS.resume,
    KEYS.reset,
    KEYS.strategy,
    KEYS.health("executor"),
]


@pytest.mark.parametrize("key", sampled(*QUERYABLES))
def test_noise_is_answered_with_a_problem_and_moves_nothing(shared: Client, place: str, key: str) -> None:
    with open_client(place) as session:
        for noise in NOISE:
            (reply,) = session.get(key, payload=noise, timeout=10.0, congestion_control=zenoh.CongestionControl.BLOCK)
            assert reply.err is not None, noise[:80]
            assert decode(Problem, reply.err.payload.to_bytes()).code == "invalid_request"
    assert shared.stands()
    assert shared.state().mode == "idle"
    assert shared.goals == []
    assert shared.ended(shared.execute(SHORT)).status == "succeeded"


def test_noise_on_the_keys_it_listens_to_does_no_harm(shared: Client, place: str) -> None:
    with open_client(place) as session:
        for noise in NOISE:
            for key in (KEYS.plans, KEYS.scene_revision):
                session.put(key, noise, congestion_control=zenoh.CongestionControl.BLOCK)
    assert shared.ended(shared.execute(SHORT)).status == "succeeded"
    with pytest.raises(InvalidRequest, match="no plan"):
        shared.execute()
