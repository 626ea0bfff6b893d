"""The latest poses of moving objects: the planner treats them as static there."""

from __future__ import annotations

import threading
from collections.abc import Callable

from zarm_contract.messages import ObjectPose, Scene, SceneObject, Sphere, Voxels


class MovedObjects:
    """The newest poses of objects in `scene()`. Thread-safe.

    An object stays at its last reported pose until it is edited. A pose for a missing object, or one made of voxels, is
    ignored here; the servo reports it.
    """

    def __init__(self, scene: Callable[[], Scene]) -> None:
        self._scene = scene
        self._lock = threading.Lock()
        self._poses: dict[str, tuple[SceneObject, SceneObject, float]] = {}
        self._placed: tuple[Scene, tuple[SceneObject, ...]] | None = None

    def receive(self, key: str, message: ObjectPose) -> None:
        """Take a message on the key of an object's pose."""
        name = key.split("/")[-2]
        item = next((item for item in self._scene().objects if item.name == name), None)
        if item is None or isinstance(item, Voxels):
            return
        pose = {"position": message.position, "orientation": message.orientation}
        if isinstance(item, Sphere):
            del pose["orientation"]
        with self._lock:
            before = self._poses.get(name)
            if before is None or before[0] is not item or message.stamp > before[2]:
                self._poses[name] = item, item.model_copy(update=pose), message.stamp
                self._placed = None

    def objects(self, scene: Scene) -> tuple[SceneObject, ...]:
        """The obstacles of the scene at their current poses: the same tuple as long as nothing has changed."""
        with self._lock:
            if self._placed is None or self._placed[0] is not scene:
                known = {item.name: item for item in scene.objects} if self._poses else {}
                self._poses = {name: one for name, one in self._poses.items() if known.get(name) is one[0]}
                self._placed = scene, self._where_they_are(scene)
            return self._placed[1]

    def objects_to_be(self, scene: Scene) -> tuple[SceneObject, ...]:
        """The same for a scene that has not taken effect yet."""
        with self._lock:
            return self._where_they_are(scene)

    def _where_they_are(self, scene: Scene) -> tuple[SceneObject, ...]:
        poses = self._poses
        if not poses:
            return scene.obstacles
        known = ((item, poses.get(item.name)) for item in scene.obstacles)
        return tuple(item if one is None or one[0] is not item else one[1] for item, one in known)
