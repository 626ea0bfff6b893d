"""Finds the installed generation of curobo_msgs by inspecting its message classes."""

from __future__ import annotations

import importlib
import logging
from collections.abc import Iterator, Mapping
from typing import Any

from zarm_ros_bridge.curobo.generations.a import GenerationA
from zarm_ros_bridge.curobo.generations.b import GenerationB
from zarm_ros_bridge.curobo.generations.c import GenerationC
from zarm_ros_bridge.curobo.generations.definitions import Fields, definitions
from zarm_ros_bridge.curobo.generations.generation import Generation

log = logging.getLogger(__name__)

ADAPTERS: tuple[type[Generation], ...] = (GenerationB, GenerationC, GenerationA)
"""All adapters; if a package is equally close to two, the first counts."""
SERVED_WHERE_THERE = ("srv/GetVoxelGrid", "srv/WarmupIK", "srv/WarmupFK")
"""Types that a package may lack: the first needs nav2_msgs, and not every package has the others."""
NOT_SERVED = (
    "action/DataGeneration",
    "msg/MpcCosts",
    "msg/ObjectParameters",
    "srv/Collisions",
    "srv/GenerateRM",
    "srv/SceneGenerator",
)
_LATER = {"action/SendTrajectory": {"controller_position_error", "controller_orientation_error"}}
"""Trailing feedback fields that an earlier B lacks."""
_EMPTY = "structure_needs_at_least_one_member"


def installed() -> Generation:
    """The generation closest to the installed package, and what of it can be served."""
    found = min((_compared(adapter) for adapter in ADAPTERS), key=lambda one: len(one.differences))
    log.info("messages package=%s", f"{found}".replace(" ", "_"))
    for difference in found.differences:
        log.warning("not served reason=%s", difference)
    for name in SERVED_WHERE_THERE:
        if name not in found.types:
            log.info("not served reason=%s is not in the curobo_msgs that is installed", name)
    return found


def _compared(adapter: type[Generation]) -> Generation:
    types, differences = {}, []
    for name, parts in definitions(adapter.letter).items():
        if name in NOT_SERVED:
            continue
        kind = _class(name)
        if kind is None:
            faults = [] if name in SERVED_WHERE_THERE else [f"{name} is not in the curobo_msgs that is installed"]
        else:
            faults = list(_differences(name, kind, parts))
            if not faults:
                types[name] = kind
        differences += faults[:1]
    return adapter(types, differences)


def _class(name: str) -> Any | None:
    folder, _, kind = name.partition("/")
    try:
        return getattr(importlib.import_module(f"curobo_msgs.{folder}"), kind, None)
    except ImportError:  # without any type of this kind
        return None


def _differences(name: str, kind: Any, parts: Mapping[str, Fields]) -> Iterator[str]:
    for part, expected in parts.items():
        message = getattr(kind, part) if part else kind
        found = {field: what for field, what in message.get_fields_and_field_types().items() if field != _EMPTY}
        missing = set(expected) - set(found)
        if missing and missing <= _LATER.get(name, set()):
            expected = {field: what for field, what in expected.items() if field not in missing}
        if list(found.items()) != list(expected.items()):
            yield f"{name}{'.' * bool(part)}{part} {_difference(found, expected)}"


def _difference(found: Fields, expected: Fields) -> str:
    """The first field that differs."""
    for (field, what), (other, wanted) in zip(found.items(), expected.items(), strict=False):
        if (field, what) != (other, wanted):
            return f"has {what} {field} where {wanted} {other} belongs"
    if len(found) > len(expected):
        return f"has {list(found)[len(expected)]}, which does not belong there"
    return f"has no {list(expected)[len(found)]}"
