"""Random payloads, the same for the same seed: near misses of real messages made by hypothesis, and mutated bytes."""

from __future__ import annotations

import json
import random
from collections.abc import Callable, Iterator
from typing import Any

from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from support.message_examples import EXAMPLES
from zarm_contract.codec import MAX_BYTES, encode
from zarm_contract.messages import Message

PORTION = 500
"""Number of near misses that hypothesis makes at a time, since it remembers all of them."""

EXTREME: tuple[object, ...] = (
    float("nan"),
    float("inf"),
    -float("inf"),
    1e308,
    -1e308,
    5e-324,
    -0.0,
    2**63,
    2**64,
    10**400,
    -(10**4000),
    "",
    "\x00",
    "../../etc/passwd",
    "joint_1",
    "zarm/**",
    "\u202e\U0001f9be\ufdd0",
    "x" * 10_000,
)
"""Values that break careless code."""


def deep(levels: int) -> object:
    """A list in a list in a list ..."""
    value: object = 0
    for _ in range(levels):
        value = [value]
    return value


def junk() -> st.SearchStrategy[object]:
    """Any JSON, including values that JSON does not allow."""
    return st.recursive(
        st.none()
        | st.booleans()
        | st.integers()
        | st.floats()
        | st.text(max_size=20)
        | st.sampled_from(EXTREME)
        | st.integers(1, 300).map(deep),
        lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
        max_leaves=8,
    )


@st.composite
def near_misses(draw: st.DrawFn, examples: list[Message]) -> bytes:
    """A message with a few faults, or by chance none, as bytes."""
    payload = json.loads(encode(draw(st.sampled_from(examples))))
    for _ in range(draw(st.sampled_from((1, 1, 2, 3, 0)))):
        _damage(draw, payload)
    text = json.dumps(payload, ensure_ascii=draw(st.booleans())).encode("utf-8", "surrogatepass")
    if draw(st.integers(0, 9)) == 0:
        return text[: draw(st.integers(0, len(text)))]
    return text


def _damage(draw: st.DrawFn, payload: Any) -> None:
    place = payload
    if not payload:
        place[draw(st.text(max_size=8))] = draw(junk())
    while place:
        keys = sorted(place) if isinstance(place, dict) else range(len(place))
        key = draw(st.sampled_from(keys))
        if isinstance(place[key], dict | list) and draw(st.booleans()):
            place = place[key]
            continue
        match draw(st.sampled_from(("replace", "remove", "repeat", "add"))):
            case "replace":
                place[key] = draw(junk())
            case "remove":
                del place[key]
            case "repeat" if isinstance(place, list):
                place.extend([place[key]] * draw(st.sampled_from((1, 2, 40))))
            case "repeat" | "add" if isinstance(place, dict):
                place[draw(st.text(max_size=8))] = place[key]
            case _:
                place.append(draw(junk()))
        return


def structured(examples: dict[str, list[Message]], count: int, number: int) -> Iterator[tuple[str, bytes]]:
    """`count` near misses, each with its key; `examples` are the messages of each key."""
    keys = sorted(examples)
    keyed = st.sampled_from(keys).flatmap(lambda key: st.tuples(st.just(key), near_misses(examples[key])))
    for begin in range(0, count, PORTION):
        yield from _drawn(keyed, min(PORTION, count - begin), f"{number} {begin}")


def _drawn(strategy: st.SearchStrategy[tuple[str, bytes]], count: int, label: str) -> list[tuple[str, bytes]]:
    made: list[tuple[str, bytes]] = []

    @seed(label)
    @settings(
        max_examples=count,
        database=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(strategy)
    def collect(one: tuple[str, bytes]) -> None:
        made.append(one)

    collect()
    return made


def mutated(examples: dict[str, list[Message]], count: int, number: int) -> Iterator[tuple[str, bytes]]:
    """`count` messages whose bytes were flipped, cut, doubled and mixed with those of others."""
    choice = random.Random(number)
    others = [encode(example) for example in EXAMPLES]
    keys = sorted(examples)
    for _ in range(count):
        key = choice.choice(keys)
        payload = bytearray(encode(choice.choice(examples[key])))
        for _ in range(choice.randint(1, 4)):
            choice.choice(_MUTATIONS)(choice, payload, others)
        yield key, bytes(payload)


def _flip(choice: random.Random, payload: bytearray, _: list[bytes]) -> None:
    if payload:
        payload[choice.randrange(len(payload))] ^= 1 << choice.randrange(8)


def _overwrite(choice: random.Random, payload: bytearray, _: list[bytes]) -> None:
    if payload:
        payload[choice.randrange(len(payload))] = choice.choice(b'\x00\xff\xed0919-+.eE"\\[]{},: \n')


def _cut(choice: random.Random, payload: bytearray, _: list[bytes]) -> None:
    begin = choice.randint(0, len(payload))
    del payload[begin : begin + choice.choice((1, 2, 16, len(payload)))]


def _double(choice: random.Random, payload: bytearray, _: list[bytes]) -> None:
    begin = choice.randint(0, len(payload))
    part = payload[begin : begin + choice.choice((1, 8, 64))]
    payload[begin:begin] = part * choice.choice((1, 3, 100))


def _splice(choice: random.Random, payload: bytearray, others: list[bytes]) -> None:
    other = choice.choice(others)
    begin, end = sorted((choice.randint(0, len(other)), choice.randint(0, len(other))))
    place = choice.randint(0, len(payload))
    payload[place : place + choice.choice((0, end - begin))] = other[begin:end]


_MUTATIONS: tuple[Callable[[random.Random, bytearray, list[bytes]], None], ...] = (
    _flip,
    _overwrite,
    _cut,
    _double,
    _splice,
)

ENORMOUS: tuple[bytes, ...] = (
    b" " * (MAX_BYTES + 1),
    b"[" * MAX_BYTES,
    b'{"joint_names": ["a"], "time": [0], "position": [%s]}' % b",".join([b"[]"] * 900_000),
    b'{"trajectory": {"joint_names": ["a"], "time": [%s]}}' % b",".join([b"-1"] * 900_000),
    b"{%s}" % b",".join(b'"%d":0' % number for number in range(90_000)),
)
"""At or just above the maximum size; each is for every key."""
