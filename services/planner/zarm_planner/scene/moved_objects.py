"""Where moving objects were told to be last: the planner plans as if they stayed there."""

from __future__ import annotations

import threading
from collections.abc import Callable

from zarm_contract.messages import ObjectPose, Scene, SceneObject, Sphere, Voxels


class MovedObjects:
    """The newest poses of objects in `scene()`. Safe from any thread.

    An object is where it was told to be last until it is edited. A pose of an object that is not there, or consists of voxels, is
    passed over; the servo says so.
    """

    def __init__(self, scene: Callable[[], Scene]) -> None:
        self._scene = scene
        self._lock = threading.Lock()
        self._told: dict[str, tuple[SceneObject, SceneObject, float]] = {}
        self._placed: tuple[tuple[SceneObject, ...], tuple[SceneObject, ...]] | None = None

    def hear(self, key: str, message: ObjectPose) -> None:
        """A message on the key of an object's pose."""
        name = key.split("/")[-2]
        item = next((item for item in self._scene().objects if item.name == name), None)
        if item is None or isinstance(item, Voxels):
            return
        pose = {"position": message.position, "orientation": message.orientation}
        if isinstance(item, Sphere):
            del pose["orientation"]
        with self._lock:
            before = self._told.get(name)
            if before is None or before[0] is not item or message.stamp > before[2]:
                self._told[name] = item, item.model_copy(update=pose), message.stamp
                self._placed = None

    def objects(self, scene: Scene) -> tuple[SceneObject, ...]:
        """All objects of the scene, each where it is now: the same tuple as long as nothing has changed."""
        with self._lock:
            if self._placed is None or self._placed[0] is not scene.objects:
                told = self._told
                known = {item.name: item for item in scene.objects} if told else {}
                self._told = told = {name: one for name, one in told.items() if known.get(name) is one[0]}
                moved = {name: placed for name, (_, placed, _) in told.items()}
                objects = tuple(moved.get(item.name, item) for item in scene.objects) if moved else scene.objects
                self._placed = scene.objects, objects
            return self._placed[1]
