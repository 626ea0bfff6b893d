"""What the scene store promises: whole edits or none, and a file that is right after a crash at any moment."""

from __future__ import annotations

import json
import resource
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from zarm_contract.errors import InvalidRequest, Unavailable
from zarm_contract.messages import (
    MAX_OBJECTS,
    AddObjects,
    Capsule,
    ClearScene,
    Cuboid,
    LoadScene,
    RemoveObjects,
    Scene,
    SceneEdit,
    SceneObject,
    Sphere,
)
from zarm_planner.scene.store import SceneStore


def ball(name: str, radius: float = 0.1) -> Sphere:
    return Sphere(kind="sphere", name=name, position=(0.0, 0.0, 1.0), radius=radius)


def add(*objects: SceneObject, replace: bool = False) -> SceneEdit:
    return SceneEdit(edit=AddObjects(op="add", objects=objects, replace=replace))


def remove(*names: str) -> SceneEdit:
    return SceneEdit(edit=RemoveObjects(op="remove", names=names))


def load(*objects: SceneObject) -> SceneEdit:
    return SceneEdit(edit=LoadScene(op="load", objects=objects))


CLEAR = SceneEdit(edit=ClearScene(op="clear"))


def names(scene: Scene) -> list[str]:
    return [item.name for item in scene.objects]


@contextmanager
def files_no_longer_than(size: int) -> Iterator[None]:
    """The system refuses to let any file of this process grow further, as a full disk does."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def number(scene: Scene) -> int:
    """How many edits it has had, by its revision."""
    return int(scene.revision.partition("-")[0])


def test_a_new_scene_is_empty_and_has_had_no_edit(tmp_path: Path) -> None:
    scene = SceneStore(tmp_path).scene
    assert scene == Scene(revision=scene.revision)
    assert number(scene) == 0


def test_every_edit_makes_the_next_revision(tmp_path: Path) -> None:
    store = SceneStore(tmp_path)
    edits = (add(ball("a"), ball("b")), add(ball("a", 0.2), replace=True), remove("b"), load(ball("c")), CLEAR, CLEAR)
    scenes = [store.edit(edit) for edit in edits]
    assert [number(scene) for scene in scenes] == [1, 2, 3, 4, 5, 6]
    assert [names(scene) for scene in scenes] == [["a", "b"], ["a", "b"], ["a"], ["c"], [], []]
    assert scenes[1].objects[0] == ball("a", 0.2)


@pytest.mark.parametrize(
    ("edit", "field", "says"),
    [
        (add(ball("new"), ball("a")), "edit.objects.1.name", "a"),
        (add(ball("new"), ball("new"), replace=True), "edit.objects.1.name", "new"),
        (load(ball("x"), ball("x")), "edit.objects.1.name", "x"),
        (remove("b", "nobody"), "edit.names.1", "nobody"),
        (add(ball("far").model_copy(update={"position": (0.0, 2e3, 0.0)})), "edit.objects.0.position", "far"),
        (add(ball("huge", 1e4)), "edit.objects.0.radius", "huge"),
        (
            add(Cuboid(kind="cuboid", name="thin", position=(0, 0, 0), size=(1, 1e-9, 1))),
            "edit.objects.0.size.1",
            "thin",
        ),
        (
            add(Capsule(kind="capsule", name="long", position=(0, 0, 0), radius=1, length=1e5)),
            "edit.objects.0.length",
            "long",
        ),
    ],
)
def test_an_invalid_edit_is_refused_by_field_and_object(tmp_path: Path, edit: SceneEdit, field: str, says: str) -> None:
    store = SceneStore(tmp_path)
    before = store.edit(add(ball("a"), ball("b")))
    with pytest.raises(InvalidRequest, match=says) as caught:
        store.edit(edit)
    assert caught.value.problem.field == field
    assert store.scene == before
    assert SceneStore(tmp_path).scene == before


def test_a_scene_holds_a_limited_number_of_objects(tmp_path: Path) -> None:
    store = SceneStore(tmp_path)
    store.edit(load(*(ball(f"b{i}") for i in range(MAX_OBJECTS))))
    with pytest.raises(InvalidRequest, match=str(MAX_OBJECTS)):
        store.edit(add(ball("one_more")))
    assert len(store.edit(add(ball("b7", 0.2), replace=True)).objects) == MAX_OBJECTS


def test_the_scene_outlives_the_process(tmp_path: Path) -> None:
    store = SceneStore(tmp_path / "deep" / "folder")
    store.edit(add(ball("a")))
    scene = store.edit(add(Cuboid(kind="cuboid", name="box", position=(0.1, 0.2, 1 / 3), size=(1.0, 1e-3, 2.0))))
    again = SceneStore(tmp_path / "deep" / "folder")
    assert again.scene == scene
    assert again.lost is None
    assert number(again.edit(CLEAR)) == number(scene) + 1


def test_what_a_crash_left_half_written_is_not_the_scene(tmp_path: Path) -> None:
    scene = SceneStore(tmp_path).edit(add(ball("a")))
    (tmp_path / "scene.json.new").write_text('{"format": 1, "scene": {"revis')
    assert SceneStore(tmp_path).scene == scene


def test_an_edit_that_cannot_be_saved_is_not_applied(tmp_path: Path) -> None:
    store = SceneStore(tmp_path)
    before = store.edit(add(ball("a")))
    with files_no_longer_than(64), pytest.raises(Unavailable, match="not applied"):
        store.edit(add(ball("b")))
    assert store.scene == before
    assert SceneStore(tmp_path).scene == before
    assert number(store.edit(add(ball("b")))) == number(before) + 1


@pytest.mark.parametrize("content", [b"", b"{}", b"\xff\xfe", b'{"format": 1, "scene": {"revision": -1}}', b"[" * 5000])
def test_a_broken_file_is_put_aside_and_said_to_be_lost(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "scene.json").write_bytes(content)
    store = SceneStore(tmp_path)
    assert store.lost is not None
    assert "scene.json.broken" in store.lost
    assert store.scene.objects == ()
    assert (tmp_path / "scene.json.broken").read_bytes() == content


def test_a_lost_scene_stays_lost_until_someone_edits_it(tmp_path: Path) -> None:
    SceneStore(tmp_path).edit(add(ball("a")))
    (tmp_path / "scene.json").write_text("broken")
    SceneStore(tmp_path)
    store = SceneStore(tmp_path)
    assert store.lost is not None
    store.edit(CLEAR)
    assert store.lost is None
    assert SceneStore(tmp_path).lost is None


@pytest.mark.parametrize("content", [None, "broken"])
def test_after_losing_its_file_no_revision_is_reused(tmp_path: Path, content: str | None) -> None:
    file, revisions = tmp_path / "scene.json", set[str]()
    for _ in range(3):
        store = SceneStore(tmp_path)
        revisions |= {store.scene.revision, store.edit(add(ball("a"))).revision, store.edit(CLEAR).revision}
        file.unlink() if content is None else file.write_text(content)
    assert len(revisions) == 9


def test_a_new_scene_is_the_same_after_a_restart(tmp_path: Path) -> None:
    assert SceneStore(tmp_path).scene == SceneStore(tmp_path).scene


def test_copies_edited_apart_are_two_scenes(tmp_path: Path) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    before = SceneStore(here).edit(add(ball("a")))
    shutil.copytree(here, there)
    assert SceneStore(there).scene == before
    assert SceneStore(here).edit(CLEAR).revision != SceneStore(there).edit(CLEAR).revision


def test_a_scene_that_is_put_back_as_it_was_is_another_one(tmp_path: Path) -> None:
    store = SceneStore(tmp_path)
    before = store.edit(add(ball("a")))
    store.edit(remove("a"))
    again = store.edit(add(ball("a")))
    assert again.objects == before.objects
    assert again.revision != before.revision


def test_the_scene_of_a_newer_zarm_is_left_alone(tmp_path: Path) -> None:
    SceneStore(tmp_path).edit(add(ball("a")))
    content = json.loads((tmp_path / "scene.json").read_text())
    (tmp_path / "scene.json").write_text(json.dumps(content | {"version": 99}))
    with pytest.raises(Unavailable, match=r"version 99.* run that version of zarm, or move the file away"):
        SceneStore(tmp_path)
    assert json.loads((tmp_path / "scene.json").read_text())["version"] == 99


_OLD_SCENE = (
    b'{"revision":7,"objects":[{"kind":"sphere","name":"a","position":[0.1,0.2,0.3],"radius":0.05}],"attached":[],'
    b'"ignored_links":[]}'
)


@pytest.mark.parametrize(
    ("version", "old"),
    [
        (0, b'{"format":1,"scene":' + _OLD_SCENE + b"}"),
        (1, b'{"version": 1, "written_by": "0.1.0", "content": ' + _OLD_SCENE + b"}"),
    ],
)
def test_the_scene_of_an_older_zarm_is_migrated(tmp_path: Path, version: int, old: bytes) -> None:
    """What zarm 0.1.0 wrote before files stated a version, and before a revision was more than a number."""
    (tmp_path / "scene.json").write_bytes(old)
    store = SceneStore(tmp_path)
    assert store.lost is None
    assert (number(store.scene), [item.name for item in store.scene.objects]) == (7, ["a"])
    assert (tmp_path / f"scene.json.v{version}").read_bytes() == old
    assert json.loads((tmp_path / "scene.json").read_text())["version"] == 2
    assert SceneStore(tmp_path).scene == store.scene


def test_a_folder_that_cannot_be_used_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(Unavailable, match="file"):
        SceneStore(tmp_path / "file" / "scene")
