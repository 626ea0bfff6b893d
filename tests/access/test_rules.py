"""Every role on every key against a real router: what the table grants gets through, and nothing else does."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
import zenoh

from support.harness import eventually, free_endpoint
from zarm_contract.access import reading, rights
from zarm_contract.key import Rights
from zarm_contract.keys import client_token
from zarm_contract.roles import EVERYONE, ROLES, Role
from zarm_runtime.session import open_client, open_router

MEMBERS = tuple(role for role in ROLES if role != "router")
FORGED, TRUE = b"forged", b"true"
SEPARATE = "zarm/no_robot/planner/health"
"""A key that every role may ask, and nobody answers."""

PUBLIC = "zarm/some_robot/joint_states"


class Sessions:
    """Two sessions of every role on one router: one that serves and publishes, one that asks and listens."""

    def __init__(self, endpoint: str, stack: ExitStack) -> None:
        self.of = {role: stack.enter_context(open_client(endpoint, role=role)) for role in MEMBERS}
        self.asking = {role: stack.enter_context(open_client(endpoint, role=role)) for role in MEMBERS}
        self.ear = self.asking["viewer"]

    def settle(self, session: zenoh.Session) -> None:
        """Wait until the router has seen all that this session sent before."""
        list(session.get(SEPARATE, timeout=10))

    def published(self, role: Role, key: str, owner: Role) -> bool:
        """Whether what `role` publishes on a key is heard."""
        heard: list[bytes] = []
        ear = self.ear.declare_subscriber(key, lambda sample: heard.append(sample.payload.to_bytes()))
        self.settle(self.ear)
        self.of[role].put(key, FORGED)
        self.settle(self.of[role])
        self.of[owner].put(key, TRUE)
        eventually(lambda: TRUE in heard, f"{owner} is heard on {key}")
        ear.undeclare()
        return FORGED in heard

    def hears(self, role: Role, key: str, owner: Role) -> bool:
        """Whether `role` gets what `owner` publishes on a key, whatever it subscribes to."""
        heard: list[str] = []
        with ExitStack() as stack:
            for expression in (key, "zarm/some_robot/**"):
                ear = self.asking[role].declare_subscriber(
                    expression, lambda sample: heard.append(str(sample.key_expr))
                )
                stack.callback(ear.undeclare)
            self.settle(self.asking[role])
            self.of[owner].put(key, TRUE)
            self.settle(self.of[owner])
            self.of["executor"].put(PUBLIC, TRUE)
            eventually(lambda: PUBLIC in heard, f"{role} hears what is for everyone")
        return key in heard

    def answered(self, role: Role, key: str, requester: Role, by: Role) -> list[bytes]:
        """What `requester` is answered on a key that `by` serves, and `role` too."""
        queryables = [
            self.of[one].declare_queryable(key, lambda query, one=one: query.reply(key, one.encode()))
            for one in {role, by}
        ]
        for one in {role, by}:
            self.settle(self.of[one])
        replies = self.asking[requester].get(key, target=zenoh.QueryTarget.ALL, timeout=10)
        answers = [reply.ok.payload.to_bytes() for reply in replies if reply.ok]
        for queryable in queryables:
            queryable.undeclare()
        return answers

    def alive(self, role: Role, key: str) -> bool:
        """Whether the token that a role declares is seen."""
        token = self.of[role].liveliness().declare_token(key)
        self.settle(self.of[role])
        seen = [str(reply.ok.key_expr) for reply in self.ear.liveliness().get(key, timeout=10) if reply.ok]
        token.undeclare()
        return key in seen


@pytest.fixture(scope="module")
def endpoint(certificates: Path) -> Iterator[str]:
    """A router with access control."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ZARM_SECURITY", "on")
        patch.setenv("ZARM_CERTS", str(certificates))
        place = free_endpoint()
        with open_router(place):
            yield place


@pytest.fixture(scope="module")
def sessions(endpoint: str) -> Iterator[Sessions]:
    """One of each role."""
    with ExitStack() as stack:
        yield Sessions(endpoint, stack)


def keys() -> list[tuple[str, Rights]]:
    """Every key, of a robot that exists nowhere."""
    return [
        ("zarm/some_robot" + pattern.removeprefix("zarm/*").replace("*", "one"), granted)
        for pattern, granted in rights().items()
    ]


def test_a_role_s_publications_are_received_only_as_in_the_table(sessions: Sessions) -> None:
    for key, granted in keys():
        for role in MEMBERS if granted.publishes else ():
            assert sessions.published(role, key, granted.publishes[0]) == (role in granted.publishes), (role, key)


def test_keys_with_readers_reach_no_other_role_by_wildcard(sessions: Sessions) -> None:
    for key, granted in keys():
        if granted.reads == EVERYONE:
            continue
        for role in MEMBERS:
            assert sessions.hears(role, key, granted.publishes[0]) == (role in granted.reads), (role, key)


def test_nobody_answers_in_the_place_of_a_service(sessions: Sessions) -> None:
    for key, granted in keys():
        for role in MEMBERS if granted.answers else ():
            (owner,) = granted.answers
            assert {*sessions.answered(role, key, granted.asks[0], owner)} == {owner.encode()}, (role, key)


def test_queries_are_answered_only_as_in_the_table(sessions: Sessions) -> None:
    for key, granted in keys():
        for role in MEMBERS if granted.answers else ():
            (owner,) = granted.answers
            assert bool(sessions.answered(owner, key, role, owner)) == (role in granted.asks), (role, key)


def test_latched_values_reach_no_other_role_by_wildcard(sessions: Sessions) -> None:
    for key, granted in keys():
        if not granted.latched:
            continue
        (owner,) = granted.answers
        queryable = sessions.of[owner].declare_queryable(key, lambda query, key=key: query.reply(key, TRUE))
        sessions.settle(sessions.of[owner])
        for role in MEMBERS:
            answers = [one for one in sessions.asking[role].get(reading(key), timeout=10) if one.ok]
            assert bool(answers) == (role in granted.reads), (role, key)
            for wide in ("zarm/**", "**", key.rsplit("/", 1)[0] + "/*"):
                if wide not in {pattern.replace("zarm/*", "zarm/some_robot") for pattern in rights()}:
                    assert not [one for one in sessions.asking[role].get(wide, timeout=10) if one.ok], (role, wide)
        queryable.undeclare()


def test_nobody_shows_itself_as_a_service_that_it_is_not(sessions: Sessions) -> None:
    for key, granted in keys():
        for role in MEMBERS if granted.lives else ():
            assert sessions.alive(role, key) == (role in granted.lives), (role, key)


def test_everyone_shows_that_it_is_there_to_be_answered(sessions: Sessions) -> None:
    for role in MEMBERS:
        assert sessions.alive(role, client_token(role)), role


def test_what_no_table_names_nobody_may(sessions: Sessions) -> None:
    for key in ("zarm/some_robot/executor/new", "another/key", "zarm/some_robot/executor/@alive/one/two"):
        for role in MEMBERS:
            heard: list[object] = []
            queryable = sessions.of["executor"].declare_queryable(key, heard.append)
            sessions.settle(sessions.of["executor"])
            assert not list(sessions.asking[role].get(key, timeout=10))
            queryable.undeclare()
            assert not heard
