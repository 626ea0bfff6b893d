"""Commands of `zarm` about the scene and the kinematics, run as a person runs them."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from support.command_line import HOME, Up, data, done, refused, vector
from support.tiers import sampled

DOWN = "0,1,0,0"
"""The orientation (x, y, z, w) of a tool that points down."""


# -- the scene --


def test_every_kind_of_object_can_be_added_listed_and_removed(up: Up, empty_scene: None) -> None:
    done(up, "scene", "add", "cuboid", "table", "--at", "0.9,-0.1,-0.3", "--size", "1,1,0.02")
    done(up, "scene", "add", "sphere", "ball", "--at", "0,-1,0.2", "--radius", "0.1")
    done(up, "scene", "add", "capsule", "pill", "--at", "0,1,0.2,0,1,0,0", "--radius", "0.1", "--length", "0.2")
    added = data(up, "scene", "add", "cylinder", "post", "--at", "-1,0,0.2", "--radius", "0.1", "--length", "0.2")
    assert added["count"] == 4
    listed = data(up, "scene", "list")
    assert {one["name"]: one["kind"] for one in listed["objects"]} == {
        "table": "cuboid",
        "ball": "sphere",
        "pill": "capsule",
        "post": "cylinder",
    }
    assert listed["revision"] == added["revision"]
    assert "table" in done(up, "scene", "list")
    done(up, "scene", "remove", "ball", "pill")
    assert {one["name"] for one in data(up, "scene", "list")["objects"]} == {"table", "post"}
    assert data(up, "scene", "clear")["count"] == 0
    assert "empty" in done(up, "scene", "list")


def test_a_name_that_exists_is_taken_only_with_replace(up: Up, empty_scene: None) -> None:
    ball = ("scene", "add", "sphere", "ball", "--at", "0,-1,0.2", "--radius")
    assert "the scene holds 1 object (" in done(up, *ball, "0.1")
    assert "1 object, revision" in done(up, "status")
    assert "ball" in refused(up, *ball, "0.2")
    done(up, *ball, "0.3", "--replace")
    assert data(up, "scene", "list")["objects"][0]["radius"] == 0.3


def test_a_saved_scene_loads_as_it_was(up: Up, empty_scene: None, tmp_path: Path) -> None:
    done(up, "scene", "add", "cuboid", "table", "--at", "0.9,-0.1,-0.3", "--size", "1,1,0.02")
    done(up, "scene", "add", "sphere", "ball", "--at", "0,-1,0.2", "--radius", "0.1")
    before = data(up, "scene", "list")["objects"]
    file = tmp_path / "scene.yaml"
    done(up, "scene", "save", str(file))
    done(up, "scene", "clear")
    assert data(up, "scene", "load", str(file))["count"] == 2
    assert data(up, "scene", "list")["objects"] == before


def test_numbers_of_a_scene_file_are_those_of_yaml(up: Up, empty_scene: None, tmp_path: Path) -> None:
    file = tmp_path / "scene.yaml"
    file.write_text("objects:\n- {kind: sphere, name: on, position: [1, 0, 2e0], radius: 4e-1}\n")
    done(up, "scene", "load", str(file))
    (ball,) = data(up, "scene", "list")["objects"]
    assert (ball["name"], ball["position"], ball["radius"]) == ("on", [1.0, 0.0, 2.0], 0.4)


@pytest.mark.parametrize(
    ("content", "said"),
    sampled(
        ("objects: [a, b\n", "scene.yaml:2"),
        ("- a\n", "a scene is a mapping"),
        (yaml.safe_dump({"objects": [{"kind": "sphere", "name": "s", "position": [0, 0, 1]}]}), "objects.0.radius"),
        ("objects:\n- {kind: sphere, name: s, position: [0, 0, 1], radius: 1}\nobjects: []\n", "scene.yaml:3: objects"),
        (
            "objects:\n- {kind: sphere, name: s, position: [0, 0, 1], radius: 1, radius: 2}\n",
            "scene.yaml:2: objects.0.radius",
        ),
        ("objects:\n- kind: sphere\n  name: s\n  position: [0, 0, 1]\n  radius: 1\n  colour: red\n", "scene.yaml:6"),
        ("objects: []\n---\nobjects: []\n", "second document"),
    ),
)
def test_a_scene_file_that_is_wrong_changes_nothing(
    up: Up, empty_scene: None, tmp_path: Path, content: str, said: str
) -> None:
    before = data(up, "scene", "list")
    file = tmp_path / "scene.yaml"
    file.write_text(content)
    line = refused(up, "scene", "load", str(file))
    assert str(file) in line
    assert said in line
    assert data(up, "scene", "list") == before


def test_an_object_with_the_name_of_a_link_is_refused(up: Up, empty_scene: None) -> None:
    line = refused(up, "scene", "add", "sphere", "link_3", "--at", "0,-1,0.2", "--radius", "0.1")
    assert "link_3 is a link of the robot" in line
    assert data(up, "scene", "list")["objects"] == []


def test_an_object_without_its_dimensions_is_refused_by_field(up: Up) -> None:
    assert "--size: a cuboid needs it" in refused(up, "scene", "add", "cuboid", "box", "--at", "1,0,0", code=2)
    assert "radius" in refused(up, "scene", "add", "cuboid", "box", "--at", "1,0,0", "--size", "1,1,1", "--radius", "1")
    assert "ghost" in refused(up, "scene", "remove", "ghost")


def test_the_robot_picks_up_and_puts_down(up: Up, empty_scene: None) -> None:
    done(up, "scene", "add", "sphere", "ball", "--at", "0.559,0.034,0.551", "--radius", "0.03")
    assert data(up, "scene", "attach", "ball", "--touch", "link_5", "--touch", "link_4")["count"] == 0
    carried = data(up, "scene", "list")["attached"][0]
    assert (carried["object"]["name"], carried["touch_links"]) == ("ball", ["link_5", "link_4"])
    assert "carries ball" in done(up, "scene", "list")
    assert "link_9" in refused(up, "scene", "attach", "ball", "--touch", "link_9")
    assert data(up, "scene", "detach", "ball", "--joints", vector(HOME))["count"] == 1
    assert "does not carry ball" in refused(up, "scene", "detach", "ball")


def test_links_are_switched_off_and_on(up: Up, empty_scene: None) -> None:
    done(up, "scene", "links", "link_6", "link_5", "--off")
    assert data(up, "scene", "list")["ignored_links"] == ["link_6", "link_5"]
    assert "are ignored: link_6, link_5" in done(up, "scene", "list")
    done(up, "scene", "links", "link_5", "link_6", "--on")
    assert data(up, "scene", "list")["ignored_links"] == []


def test_a_pair_may_touch_and_is_checked_again(up: Up, empty_scene: None) -> None:
    done(up, "scene", "add", "sphere", "ball", "--at", "0.9,0,0.2", "--radius", "0.05")
    done(up, "scene", "pair", "link_6", "ball", "--off")
    assert data(up, "scene", "list")["ignored_pairs"] == [["ball", "link_6"]]
    assert "pairs whose collisions are ignored: ball with link_6" in done(up, "scene", "list")
    assert "nobody is neither a link" in refused(up, "scene", "pair", "link_6", "nobody", "--off")
    done(up, "scene", "pair", "ball", "link_6", "--on")
    assert data(up, "scene", "list")["ignored_pairs"] == []


# -- kinematics --


def test_fk_and_ik_agree(up: Up, empty_scene: None) -> None:
    tip = data(up, "fk", "--joints", vector(HOME))["poses"][0]
    assert tip["position"] == pytest.approx([0.559, 0.0345, 0.651], abs=0.002)
    pose = vector((*tip["position"], *tip["orientation"]))
    solutions = data(up, "ik", "--to", pose, "--near", vector(HOME))["solutions"][0]
    assert solutions[0] == pytest.approx(HOME, abs=1e-3)
    assert len(done(up, "ik", "--to", pose, "--max-solutions", "2").splitlines()) <= 2
    assert "0.559" in done(up, "fk", "--joints", vector(HOME))
    assert "unreachable" in refused(up, "ik", "--to", f"5,0,0,{DOWN}")


def test_check_tells_what_a_configuration_would_hit(up: Up, empty_scene: None) -> None:
    assert data(up, "check", "--joints", vector(HOME))["results"][0]["in_collision"] is False
    done(up, "scene", "add", "sphere", "ball", "--at", "0.559,0.034,0.651", "--radius", "0.1")
    result = data(up, "check", "--joints", vector(HOME))["results"][0]
    assert result["in_collision"] is True
    assert "ball" in result["pair"]
    assert "ball" in done(up, "check", "--joints", vector(HOME))
    assert "spheres" not in done(up, "check", "--joints", vector(HOME))
    assert "spheres" in done(up, "check", "--joints", vector(HOME), "--spheres")
    assert min(data(up, "check", "--joints", vector(HOME), "--spheres")["results"][0]["spheres"]) < 0.0
