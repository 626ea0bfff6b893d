"""Access control: one table of keys and roles, and the router rules that follow from it.

Any process with a certificate may read: subscribe to everything, read latched values, see which processes are alive. `TABLE`
lists what else it may publish, answer, or request; everything that is not listed there is denied.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import chain
from typing import Literal, get_args

import zenoh

from zarm_contract.errors import InvalidRequest
from zarm_contract.keys import ALL_ALIVE, ALL_CLIENTS, Keys

Role = Literal["router", "planner", "executor", "servo", "bridge", "driver", "operator", "viewer"]
"""What a process is on the bus; the common name of its certificate."""

ROLES: tuple[Role, ...] = get_args(Role)
SERVICE_ROLES: Mapping[str, Role] = {
    "planner": "planner",
    "executor": "executor",
    "servo": "servo",
    "ros_bridge": "bridge",
    "leeloo_sim": "driver",
}
"""The role of each service, by its name on the bus."""

Roles = tuple[Role, ...]
Verb = Literal["publishes", "answers", "asks", "lives"]

_EVERYONE: Roles = tuple(role for role in ROLES if role != "router")
_DRIVES: Roles = ("operator", "bridge")
"""Those who make plans, change the scene, and move the robot."""


@dataclass(frozen=True)
class Rights:
    """What each role may do on a key: publish, answer requests, send requests to exactly this key, which may act, or
    declare the key as its liveliness token.

    `latched`: everyone may read the present value, through `reading(key)`, which no service takes for a request to act.
    """

    publishes: Roles = ()
    answers: Roles = ()
    asks: Roles = ()
    lives: Roles = ()
    latched: bool = False


def _request(to: Role, by: Roles = _DRIVES) -> Rights:
    return Rights(answers=(to,), asks=by)


def _value(of: Role, changed_by: Roles = _EVERYONE) -> Rights:
    """Latched; and who may change it by a request, if anyone."""
    return Rights(publishes=(of,), answers=(of,), asks=changed_by, latched=True)


def _published(*by: Role) -> Rights:
    return Rights(publishes=by)


TABLE: Mapping[str, Rights] = {
    "plan": _request("planner", by=(*_DRIVES, "servo")),  # which replans around obstacles
    "plan_cancel": _request("planner"),
    "ik": _request("planner"),
    "fk": _request("planner", by=_EVERYONE),  # for the tip's pose
    "check": _request("planner", by=_EVERYONE),  # for clearances
    "occupancy": _request("planner"),
    "settings": _value("planner", changed_by=_DRIVES),
    "planners": _value("planner"),
    "plans": _value("planner"),
    "scene": _value("planner"),
    "scene_object": _value("planner"),
    "object_pose": _published("operator", "bridge"),  # like edits of the scene
    "scene_revision": _value("planner"),
    "scene_edit": _request("planner"),
    "execute": _request("executor"),
    "goal": _value("executor"),
    "cancel": _request("executor"),
    "stop": _request("executor", by=_EVERYONE),  # anyone who sees that a robot must stop may stop it, even a viewer
    "pause": _request("executor"),
    "resume": _request("executor"),
    "reset": _request("executor"),
    "strategy": _value("executor", changed_by=_DRIVES),
    "speed": _value("executor", changed_by=_DRIVES),
    "stream": _published("operator", "bridge", "servo"),
    "authority": _published("servo"),
    "replace": _request("executor", by=("servo",)),
    "goal_trajectory": _value("executor"),
    "executor_state": _value("executor"),
    "servo_start": _request("servo"),
    "servo_end": _request("servo"),
    "servo_target": _published("operator", "bridge"),
    "servo_state": _value("servo"),
    "driver_command": _published("executor"),
    "driver_progress": _published("driver", "bridge"),
    "driver_joint_states": _published("driver", "bridge"),
    "simulated_fault": _request("driver", by=("operator",)),
    "joint_states": _published("executor"),
    "preview_trajectory": _published("executor"),
    "preview_joint_states": _published("executor"),
}
"""The rights on each key of `Keys`, by the name of its property; those common to all services follow from
SERVICE_ROLES.
"""

_FAMILIES: Mapping[str, str] = {"scene_object": "*", "object_pose": "*", "goal": "*"}
"""The keys that contain a name, and the wildcard that stands for all of them."""


def reading(key: str) -> str:
    """A key expression that reads the latched value of `key` and has no other effect.

    It matches `key` without being `key`: a service takes only its own name for a request that may act.
    """
    return key if key.endswith("*") else f"{key}$*"


def rights() -> dict[str, Rights]:
    """The rights by key expression, for any robot."""
    keys = Keys("any")
    table = {
        _of_any(getattr(keys, name)(_FAMILIES[name]) if name in _FAMILIES else getattr(keys, name)): granted
        for name, granted in TABLE.items()
    }
    for service, role in SERVICE_ROLES.items():
        table[_of_any(keys.health(service))] = Rights(answers=(role,), asks=_EVERYONE, latched=True)
        table[_of_any(keys.reread(service))] = _request(role)
        table[_of_any(keys.alive(service, "*"))] = Rights(lives=(role,))
    return table


def _of_any(key: str) -> str:
    return "/".join(("zarm", "*", *key.split("/")[2:]))


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
        _rule("everyone reads", ("query",), (reading(key) for key, granted in table.items() if granted.latched)),
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
                f"{role} does no more than read",
                ("query",),
                (key for key, granted in table.items() if granted.latched and role not in granted.asks),
                permission="deny",
            ),
            _rule(
                f"{role} is alive",
                ("liveliness_token",),
                (key for key, granted in table.items() if role in granted.lives),
            ),
        ]
        for role in _EVERYONE
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
