"""Access control: the router rules that follow from the rights of each key.

Any process with a certificate may read: subscribe to everything, read latched values, see which processes are alive. A key may
name its readers. The keys say what else a role may publish, answer, or request; everything else is denied.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cache
from itertools import chain
from typing import Literal

import zenoh

from zarm_contract.errors import InvalidRequest
from zarm_contract.key import Rights
from zarm_contract.keys import ALL_ALIVE, ALL_CLIENTS, every_key
from zarm_contract.roles import EVERYONE, Role, Roles

Verb = Literal["publishes", "answers", "asks", "lives", "reads"]


def reading(key: str) -> str:
    """A key expression that reads the latched value of `key` and has no other effect.

    It matches `key` without being `key`: a service takes only its own name for a request that may act.
    """
    return key if key.endswith("*") else f"{key}$*"


def rights() -> dict[str, Rights]:
    """The rights by key expression, for any robot."""
    return {key: key.rights for key in every_key()}


def require(role: Role, verb: Verb, key: str) -> None:
    """Raise InvalidRequest if a role may not do this on a key: a router with these rules would drop it."""
    granted = next((granted for pattern, granted in _patterns() if pattern.includes(key)), Rights())
    allowed: Roles = getattr(granted, verb)
    if role not in allowed:
        whose = f"that is for the role {' or '.join(allowed)}" if allowed else "no role is"
        raise InvalidRequest(f"the role {role} is not allowed {_VERBS[verb]} {key}; {whose}")


@cache
def _patterns() -> list[tuple[zenoh.KeyExpr, Rights]]:
    return [(zenoh.KeyExpr(pattern), granted) for pattern, granted in rights().items()]


_VERBS = {
    "publishes": "to publish on",
    "answers": "to answer on",
    "asks": "to send requests to",
    "lives": "to be alive as",
    "reads": "to read",
}


def access_control() -> dict[str, object]:
    """Zenoh's `access_control`: anything not allowed here is denied, and without a role everything."""
    table = rights()
    everyone = [
        _rule("everyone hears what is for it", _ALL_MESSAGES, _EVERYTHING, flow="egress"),
        _rule("everyone subscribes", ("declare_subscriber",), ("zarm/**",)),
        _rule("everyone shows that it is there", ("liveliness_token",), (ALL_CLIENTS,)),
        _rule(
            "everyone sees who is alive",
            ("liveliness_query", "declare_liveliness_subscriber"),
            (ALL_ALIVE, ALL_CLIENTS),
        ),
        _rule(
            "everyone reads",
            ("query",),
            (reading(key) for key, granted in table.items() if granted.latched and granted.reads == EVERYONE),
        ),
    ]
    own: dict[Role, list[dict[str, object]]] = {
        role: [
            _rule(f"{role} publishes", ("put",), (key for key, granted in table.items() if role in granted.publishes)),
            _rule(
                f"{role} answers",
                ("declare_queryable", "reply"),
                chain.from_iterable(
                    (key, reading(key)) if granted.latched else (key,)
                    for key, granted in table.items()
                    if role in granted.answers
                ),
            ),
            _rule(f"{role} asks", ("query",), (key for key, granted in table.items() if role in granted.asks)),
            _rule(
                f"{role} reads what is not for everyone",
                ("query",),
                (
                    reading(key)
                    for key, granted in table.items()
                    if granted.latched and granted.reads != EVERYONE and role in granted.reads
                ),
            ),
            _rule(
                f"{role} does no more than read",
                ("query",),
                (key for key, granted in table.items() if granted.latched and role not in granted.asks),
                permission="deny",
            ),
            _rule(
                f"{role} gets nothing that is for others",
                ("put",),
                (key for key, granted in table.items() if role not in granted.reads),
                flow="egress",
                permission="deny",
            ),
            _rule(
                f"{role} is alive",
                ("liveliness_token",),
                (key for key, granted in table.items() if role in granted.lives),
            ),
        ]
        for role in EVERYONE
    }
    own["router"] = [_rule("routers pass on", _ALL_MESSAGES, _EVERYTHING, flow=flow) for flow in ("ingress", "egress")]
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [rule for rule in chain(everyone, *own.values()) if rule["key_exprs"]],
        "subjects": [{"id": role, "cert_common_names": [role]} for role in own],
        "policies": [
            {
                "subjects": [role],
                "rules": [
                    rule["id"] for rule in chain(() if role == "router" else everyone, rules) if rule["key_exprs"]
                ],
            }
            for role, rules in own.items()
        ],
    }


_EVERYTHING = ("zarm/**", ALL_ALIVE, ALL_CLIENTS)
_ALL_MESSAGES = (
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "declare_queryable",
    "reply",
    "liveliness_token",
    "liveliness_query",
    "declare_liveliness_subscriber",
)


def _rule(
    name: str,
    messages: Sequence[str],
    keys: Iterable[str],
    *,
    flow: Literal["ingress", "egress"] = "ingress",
    permission: Literal["allow", "deny"] = "allow",
) -> dict[str, object]:
    return {
        "id": f"{name} ({flow})",
        "permission": permission,
        "flows": [flow],
        "messages": list(messages),
        "key_exprs": list(dict.fromkeys(keys)),
    }
