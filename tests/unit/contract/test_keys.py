"""The keys of the bus: each under its robot's name, none of them caught by a subscription to another."""

from __future__ import annotations

from itertools import combinations, product

import pytest
import zenoh

from zarm_contract.key import Key
from zarm_contract.keys import ALL_ALIVE, Keys, declared, parse_alive

SERVICES = ("planner", "executor", "servo", "perception", "ros_bridge", "leeloo_sim")


def every_key(robot: str) -> dict[str, str]:
    """Every key of one robot, families and services with the widest expression that they are used with."""
    keys = Keys(robot)
    plain = {name: getattr(keys, name) for name, value in vars(Keys).items() if isinstance(value, Key)}
    families = {
        "scene_object": keys.scene_object("*"),
        "object_pose": keys.object_pose("*"),
        "goal": keys.goal("*"),
        "gripper_state": keys.gripper_state("*"),
        "output_state": keys.output_state("*"),
        "color": keys.color("*"),
        "depth": keys.depth("*"),
        "mask": keys.mask("*"),
        "cloud": keys.cloud("*"),
        "voxels": keys.voxels("*"),
    }
    of_services = {
        f"{kind}({service})": key
        for service in SERVICES
        for kind, key in (
            ("health", keys.health(service)),
            ("reread", keys.reread(service)),
            ("alive", keys.alive(service, "*")),
        )
    }
    return plain | families | of_services


def test_the_walk_covers_every_key() -> None:
    assert {*declared()} == {name.split("(")[0] for name in every_key("arm")}


def test_no_two_keys_of_a_robot_intersect() -> None:
    for (name, key), (other, other_key) in combinations(every_key("arm").items(), 2):
        assert not zenoh.KeyExpr(key).intersects(zenoh.KeyExpr(other_key)), f"{name} and {other}"


def test_no_key_of_a_robot_intersects_one_of_another() -> None:
    for (name, key), (other, other_key) in product(every_key("arm").items(), every_key("arm_2").items()):
        assert not zenoh.KeyExpr(key).intersects(zenoh.KeyExpr(other_key)), f"{name} and {other}"


def test_every_key_begins_with_its_robot() -> None:
    assert all(key.startswith("zarm/arm/") for key in every_key("arm").values())


def test_every_key_is_a_canonical_key_expression() -> None:
    for key in every_key("arm").values():
        assert str(zenoh.KeyExpr.autocanonize(key)) == key


@pytest.mark.parametrize("robot", ["doosan_m1013", "a", "ur5e", "left_2", "x" * 64])
def test_a_robot_name_is_lower_case_alphanumeric(robot: str) -> None:
    assert Keys(robot).plan == f"zarm/{robot}/planner/plan"


@pytest.mark.parametrize(
    "robot",
    [
        "",
        "UR5",
        "2arms",
        "_arm",
        "arm-2",
        "arm 2",
        "arm/2",
        "arm*",
        "*",
        "**",
        "@arm",
        "arm$*",
        "ärm",
        "arm\n",
        "x" * 65,
    ],
)
def test_any_other_robot_name_is_refused(robot: str) -> None:
    with pytest.raises(ValueError, match="lower case letters"):
        Keys(robot)


def test_a_liveliness_token_tells_robot_service_and_instance() -> None:
    key = Keys("arm").alive("executor", "0a1b2c3d")
    assert parse_alive(key) == ("arm", "executor", "0a1b2c3d")
    assert zenoh.KeyExpr(ALL_ALIVE).includes(zenoh.KeyExpr(key))


@pytest.mark.parametrize("key", ["", "zarm/arm/planner/plan", "zarm/arm/planner/@alive", "other/arm/planner/@alive/1"])
def test_another_key_is_no_liveliness_token(key: str) -> None:
    with pytest.raises(ValueError, match="not a liveliness token"):
        parse_alive(key)


def test_looking_at_everything_shows_no_liveliness_tokens() -> None:
    """The chunk `@alive` is verbatim: `*` and `**` pass it over, so `zarm/**` stays what is published."""
    assert not zenoh.KeyExpr("zarm/**").intersects(zenoh.KeyExpr(Keys("arm").alive("planner", "1")))
