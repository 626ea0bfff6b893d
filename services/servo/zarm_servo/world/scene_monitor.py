"""The servo's own copy of the scene, read from the bus object by object; it outlives the planner."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

from zarm_contract import messages
from zarm_contract.messages import Attached, Scene, SceneObject, SceneRevision
from zarm_geometry.allowed_collisions import Pairs
from zarm_geometry.gripper_openings import openings_of
from zarm_geometry.robot_model import Openings

SCENES_KEPT = 4
"""Number of past scenes kept, in which a goal may have been verified."""
EARLY = 2.0
"""How long (s) an object counts before its scene has arrived."""


@dataclass(frozen=True)
class SceneSnapshot:
    """The known scene. `revision` is None before the first scene.

    `objects` are by name, blocks of the voxel map among them. They may be newer than the scene, because an object is published before its scene. If `lost`,
    the planner has restarted without its scene, and the last known one still counts. `openings` are those of the grippers.
    """

    revision: SceneRevision | None = None
    objects: Mapping[str, SceneObject] = field(default_factory=dict)
    attached: tuple[Attached, ...] = ()
    ignored_links: tuple[str, ...] = ()
    ignored_pairs: Pairs = ()
    lost: bool = False
    openings: Openings = ()


class SceneMonitor:
    """Keeps a `SceneSnapshot` up to date, and calls `changed` after every change. Thread-safe."""

    def __init__(self, changed: Callable[[], None]) -> None:
        self._changed = changed
        self._lock = threading.Lock()
        self._scene = self._latest = SceneSnapshot()
        self._ignored: frozenset[str] = frozenset()  # objects whose collisions are not checked
        self._voxels: Mapping[str, SceneObject] = {}
        self._early_until = 0.0
        self._past: OrderedDict[SceneRevision, SceneSnapshot] = OrderedDict()

    def snapshot(self, now: float) -> SceneSnapshot:
        """The scene known at `now` (s, monotonic), as an immutable snapshot."""
        with self._lock:
            if now > self._early_until:
                self._latest = self._scene
            return self._latest

    def at(self, revision: SceneRevision | None, openings: messages.Openings) -> SceneSnapshot | None:
        """The scene of this revision with grippers at these openings, if it was seen and is among those kept."""
        with self._lock:
            scene = None if revision is None else self._past.get(revision)
        return None if scene is None else replace(scene, openings=openings_of(openings))

    def on_object(self, item: SceneObject, now: float) -> None:
        """An object was added or moved; its scene follows."""
        with self._lock:
            before = self._latest
            if before.objects.get(item.name) == item or item.name in self._ignored:
                return
            self._latest = replace(before, objects={**before.objects, item.name: item})
            self._early_until = now + EARLY
        self._changed()

    def on_openings(self, openings: Openings) -> None:
        """Grippers have moved."""
        with self._lock:
            self._scene = replace(self._scene, openings=openings)
            self._latest = replace(self._latest, openings=openings)
        self._changed()

    def on_voxels(self, blocks: Mapping[str, SceneObject]) -> None:
        """The voxel map has changed: these are all of its blocks."""
        with self._lock:
            before, self._voxels = self._voxels, blocks
            self._scene, self._latest = (
                replace(
                    scene,
                    objects={**{name: item for name, item in scene.objects.items() if name not in before}, **blocks},
                )
                for scene in (self._scene, self._latest)
            )
        self._changed()

    def on_scene(self, _key: str, scene: Scene) -> None:
        """Take the whole scene, published after every edit."""
        with self._lock:
            before = self._scene
            if scene.revision == before.revision:
                lost = before.lost
            else:
                # The edit count of a scene only grows; if it does not, the planner has begun a new scene.
                lost = before.revision is not None and _edits(scene.revision) <= _edits(before.revision)
            kept = {name: item for name, item in before.objects.items() if lost and name not in self._voxels}
            objects = {**kept, **{item.name: item for item in scene.obstacles}}
            self._ignored = frozenset(scene.ignored_objects)
            edited = SceneSnapshot(
                scene.revision,
                objects,
                scene.carried,
                scene.ignored_links,
                scene.ignored_pairs,
                lost,
                before.openings,
            )
            self._scene = self._latest = replace(edited, objects={**objects, **self._voxels})
            # A plan may have been made before the cameras saw what they see now.
            self._past[scene.revision] = edited
            self._past.move_to_end(scene.revision)
            if len(self._past) > SCENES_KEPT:
                self._past.popitem(last=False)
        self._changed()


def _edits(revision: SceneRevision) -> int:
    return int(revision.partition("-")[0])
