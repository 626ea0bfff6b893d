"""The table of who may do what: complete, and what the router is told follows from it."""

from __future__ import annotations

import inspect
from pathlib import Path

import pytest
import zenoh

from support import router_file
from zarm_contract.access import access_control, require, rights
from zarm_contract.errors import InvalidRequest
from zarm_contract.keys import Keys, declared
from zarm_contract.roles import ROLES, SERVICE_ROLES
from zarm_runtime.recorded import Recorded
from zarm_runtime.session import router_config

KEYS = Keys("any_robot")
OF_EVERY_SERVICE = {"health", "reread", "alive"}
OF_AGENTS_TOO = [KEYS.execute, KEYS.cancel, KEYS.speed, KEYS.gripper, KEYS.scene_edit, KEYS.program]
NOT_OF_AGENTS = [KEYS.pause, KEYS.resume, KEYS.reset, KEYS.strategy, KEYS.settings, KEYS.servo_start, KEYS.servo_chunk]


def test_every_key_stands_in_the_table() -> None:
    names = {name for name, _ in inspect.getmembers(Keys) if not name.startswith("_")}
    assert names == {*declared()}


def test_every_key_has_somebody_who_owns_it() -> None:
    for key, granted in rights().items():
        assert granted.publishes or granted.answers or granted.lives, key


def test_only_the_executor_commands_a_driver() -> None:
    for role in ROLES:
        if role == "executor":
            require(role, "publishes", KEYS.driver_command)
        else:
            with pytest.raises(InvalidRequest, match="that is for the role executor"):
                require(role, "publishes", KEYS.driver_command)


@pytest.mark.parametrize("key", NOT_OF_AGENTS)
def test_only_operators_and_the_bridge_command_and_configure(key: str) -> None:
    assert {role for role in ROLES if _may(role, key)} == {"operator", "bridge"}


@pytest.mark.parametrize("key", OF_AGENTS_TOO)
def test_agents_execute_and_change_what_is_planned_around_too(key: str) -> None:
    clients = {role for role in ROLES if _may(role, key)} - {
        "servo",
        "executor",
    }  # which grip for a chunk, or lead another
    assert clients == {"operator", "bridge", "agent"}


def test_who_moves_the_robot_cannot_read_the_simulation_s_truth() -> None:
    for key in (KEYS.physics_state, KEYS.physics_objects):
        for role in ("planner", "servo", "executor", "bridge"):
            with pytest.raises(InvalidRequest, match="that is for the role operator or viewer"):
                require(role, "reads", key)
        require("viewer", "reads", key)


def test_the_servo_may_request_plans() -> None:
    assert {role for role in ROLES if _may(role, KEYS.plan)} == {"operator", "bridge", "agent", "servo"}


def test_everyone_may_stop_the_robot() -> None:
    assert {role for role in ROLES if _may(role, KEYS.stop)} == {*ROLES} - {"router"}


def test_a_service_answers_and_is_alive_as_itself_alone() -> None:
    for service, role in SERVICE_ROLES.items():
        for other in ROLES:
            for verb, key in (("answers", KEYS.health(service)), ("lives", KEYS.alive(service, "1"))):
                if other == role:
                    require(other, verb, key)  # type: ignore[arg-type]
                else:
                    with pytest.raises(InvalidRequest):
                        require(other, verb, key)  # type: ignore[arg-type]


def test_what_a_record_begins_with_a_viewer_may_read() -> None:
    latched = [zenoh.KeyExpr(key) for key, granted in rights().items() if granted.latched]
    for key in (key for key in Recorded(KEYS).keys.values() if key.recorded == "value and changes"):
        assert any(pattern.includes(key) for pattern in latched), key


def test_no_policy_allows_what_is_in_no_rule() -> None:
    control = access_control()
    assert control["enabled"] is True
    assert control["default_permission"] == "deny"
    named = {rule for policy in control["policies"] for rule in policy["rules"]}  # type: ignore[attr-defined]
    assert named == {rule["id"] for rule in control["rules"]}  # type: ignore[attr-defined]
    assert {subject["id"] for subject in control["subjects"]} == {*ROLES}  # type: ignore[attr-defined]


def test_the_file_for_other_routers_holds_what_zarm_sets_itself(secured: Path) -> None:
    mine = str(router_config()).replace(str(secured), router_file.CERTIFICATES)
    assert str(zenoh.Config.from_file(str(router_file.FILE))) == mine


def test_the_file_for_other_routers_is_made_from_the_table() -> None:
    assert router_file.FILE.read_text() == router_file.text(), "run python tests/support/router_file.py"


def _may(role: str, key: str) -> bool:
    try:
        require(role, "asks", key)  # type: ignore[arg-type]
    except InvalidRequest:
        return False
    return True
