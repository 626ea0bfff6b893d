"""Edits of what is not checked for collisions: links, objects, and pairs of the two."""

from __future__ import annotations

from collections.abc import Collection

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import MAX_PAIRED, VOXEL_MAP, Scene, SetLinkCollision, SetObjectCollision, SetPairCollision


def set_links(scene: Scene, edit: SetLinkCollision) -> Scene:
    """The scene with collisions of these links checked or ignored; no effect on links already in that state."""
    if edit.enabled:
        ignored = tuple(name for name in scene.ignored_links if name not in edit.names)
    else:
        ignored = tuple(dict.fromkeys((*scene.ignored_links, *edit.names)))
    return scene.model_copy(update={"ignored_links": ignored})


def set_objects(scene: Scene, edit: SetObjectCollision) -> Scene:
    """The scene with collisions of these objects checked or ignored. Raises InvalidRequest for an unknown one."""
    there = names_in(scene)
    for index, name in enumerate(edit.names):
        if name not in there:
            raise InvalidRequest(
                f"there is no object {name} in the scene; read the names from the scene first",
                field=f"edit.names.{index}",
            )
    if edit.enabled:
        ignored = tuple(name for name in scene.ignored_objects if name not in edit.names)
    else:
        ignored = tuple(dict.fromkeys((*scene.ignored_objects, *edit.names)))
    return scene.model_copy(update={"ignored_objects": ignored})


def set_pairs(scene: Scene, edit: SetPairCollision, links: Collection[str]) -> Scene:
    """The scene with collisions of these pairs checked or ignored. Raises InvalidRequest for a name that is none of the `links` and no object."""
    loose, there = {VOXEL_MAP, *(item.name for item in scene.objects)}, {VOXEL_MAP, *names_in(scene)}
    for index, pair in enumerate(edit.names):
        field = f"edit.names.{index}"
        for name in pair:
            if name not in there and name not in links:
                raise InvalidRequest(
                    f"{name} is neither a link with collision geometry nor an object of the scene; read the names from the scene first",
                    field=field,
                )
        if pair[0] == pair[1] or {*pair} <= loose:
            raise InvalidRequest(
                f"{pair[0]} and {pair[1]} are never checked against each other; a pair has a link or an attached object in it",
                field=field,
            )
    before = {frozenset(pair): pair for pair in scene.ignored_pairs}
    named = {frozenset(pair): pair for pair in edit.names}
    kept = {key: pair for key, pair in before.items() if key not in named} if edit.enabled else {**named, **before}
    names = {name for pair in kept for name in pair}
    if len(names) > MAX_PAIRED:
        raise InvalidRequest(
            f"{len(names)} names would be in ignored pairs, more than {MAX_PAIRED}; ignore a link or an object as a whole",
            field="edit.names",
        )
    return scene.model_copy(update={"ignored_pairs": tuple(sorted(tuple(sorted(pair)) for pair in kept.values()))})


def without_gone(scene: Scene, links: Collection[str]) -> Scene:
    """The scene without ignored objects, and pairs of them, that are no longer there."""
    there = names_in(scene)
    objects = tuple(name for name in scene.ignored_objects if name in there)
    known = {VOXEL_MAP, *there, *links}
    pairs = tuple(pair for pair in scene.ignored_pairs if known.issuperset(pair))
    if (objects, pairs) == (scene.ignored_objects, scene.ignored_pairs):
        return scene
    return scene.model_copy(update={"ignored_objects": objects, "ignored_pairs": pairs})


def names_in(scene: Scene) -> set[str]:
    """The names of all objects of a scene, also of attached ones."""
    return {item.name for item in scene.objects} | {one.object.name for one in scene.attached}
