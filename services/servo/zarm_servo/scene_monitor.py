"""The servo's own copy of the scene, read from the bus object by object; it outlives the planner."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

from zarm_contract.messages import Attached, Scene, SceneObject, SceneRevision

REMEMBERED = 4
"""So many scenes are kept, in which a goal may have been verified."""
EARLY = 2.0
"""An object counts for so long (s) before the scene that it belongs to has come."""


@dataclass(frozen=True)
class SceneSnapshot:
    """What is known of the scene. `revision`: None before the first one.

    `objects` by their names. They may be newer than the scene: an object is told before the scene that it belongs to. Where
    `lost`, the planner has come back without its scene, and what was known before still counts.
    """

    revision: SceneRevision | None = None
    objects: Mapping[str, SceneObject] = field(default_factory=dict)
    attached: tuple[Attached, ...] = ()
    ignored_links: tuple[str, ...] = ()
    lost: bool = False


class SceneMonitor:
    """Keeps `SceneSnapshot` up to date; `changed` is called after every change. Safe from any thread."""

    def __init__(self, changed: Callable[[], None]) -> None:
        self._changed = changed
        self._lock = threading.Lock()
        self._scene = self._latest = SceneSnapshot()
        self._early_until = 0.0
        self._past: OrderedDict[SceneRevision, SceneSnapshot] = OrderedDict()

    def snapshot(self, now: float) -> SceneSnapshot:
        """What is known at the moment `now` (s, monotonic); it never changes."""
        with self._lock:
            if now > self._early_until:
                self._latest = self._scene
            return self._latest

    def at(self, revision: SceneRevision | None) -> SceneSnapshot | None:
        """The scene of this revision, where it was seen and is not long gone."""
        with self._lock:
            return None if revision is None else self._past.get(revision)

    def hear_object(self, item: SceneObject, now: float) -> None:
        """An object was added, or put elsewhere; the scene that it belongs to follows."""
        with self._lock:
            before = self._latest
            if before.objects.get(item.name) == item:
                return
            self._latest = replace(before, objects={**before.objects, item.name: item})
            self._early_until = now + EARLY
        self._changed()

    def hear_scene(self, _key: str, scene: Scene) -> None:
        """The scene, whole, after every edit."""
        with self._lock:
            before = self._scene
            if scene.revision == before.revision:
                lost = before.lost
            else:
                # Of one scene the count of edits grows; where it does not, the planner has begun another one.
                lost = before.revision is not None and _edits(scene.revision) <= _edits(before.revision)
            kept = before.objects if lost else {}
            objects = {**kept, **{item.name: item for item in scene.objects}}
            self._scene = self._latest = SceneSnapshot(
                scene.revision, objects, scene.attached, scene.ignored_links, lost
            )
            self._past[scene.revision] = self._scene
            self._past.move_to_end(scene.revision)
            if len(self._past) > REMEMBERED:
                self._past.popitem(last=False)
        self._changed()


def _edits(revision: SceneRevision) -> int:
    return int(revision.partition("-")[0])
