"""Scenes ready for planning: prepared once per revision, margins, poses of moving objects and state of the voxel map."""

from __future__ import annotations

import operator
import threading
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache

from zarm_contract.errors import Unavailable
from zarm_contract.messages import Scene, SceneObject
from zarm_geometry.exact import ExactScene
from zarm_geometry.robot_model import Openings, RobotModel
from zarm_geometry.voxel_blocks import VoxelBlocks
from zarm_geometry.world import World
from zarm_planner.scene.moved_objects import MovedObjects
from zarm_planner.scene.planning_scene import PlanningScene
from zarm_planner.scene.store import SceneStore

_CARRIERS = 8
"""Robots with different loads that are kept ready; to make one ready takes some 50 ms."""


class SceneCache:
    """The present scene of `store` and the latest edit of it, ready for planning. Thread-safe."""

    def __init__(self, model: RobotModel, store: SceneStore) -> None:
        self._store = store
        self.moved = MovedObjects(lambda: store.scene)
        self.voxels = VoxelBlocks()
        self._lock = threading.Lock()
        # The robot with what it carries and the links that are ignored, for the latest of those.
        self._carriers = lru_cache(maxsize=_CARRIERS)(model.with_attached)
        # With their objects in place: those of the latest plan and of the latest edit.
        self._ready: ReadyScene | None = None
        self._edited: ReadyScene | None = None
        self._world: World | None = None  # the newest world; the next one reuses its unchanged parts

    def prepare(self, scene: Scene, openings: Openings = ()) -> None:
        """Prepare for an edited scene before it takes effect, so that no plan waits for it."""
        self._with(scene, openings).with_self_margin(
            0.0
        )  # measures the clearance between its links, once for all margins
        with suppress(Unavailable):  # a mesh file is missing; every plan will report that
            self._edited = self.ready(
                scene, (*self.moved.objects_to_be(scene), *self.voxels.objects.values()), openings
            )
            self._edited.scene.exact.prepare()

    def present(self, margin: float, self_margin: float = 0.0, openings: Openings = ()) -> PlanningScene:
        """The present scene with a margin to objects and one between the robot's links (m), and with grippers at these openings.

        Raises Unavailable while the file of one of its meshes is missing.
        """
        with self._lock:
            scene = self._store.scene
            objects = self.objects(scene)
            known = (
                ready
                for ready in (self._ready, self._edited)
                if ready is not None and ready.holds(scene, objects, openings)
            )
            ready = self._ready = next(known, None) or self.ready(scene, objects, openings)
        return ready.with_margins(margin, self_margin)

    def robot(self) -> RobotModel:
        """The robot with its tools and what else it carries in the present scene, its grippers open."""
        return self._with(self._store.scene, ())

    def objects(self, scene: Scene) -> tuple[SceneObject, ...]:
        """The obstacles of a scene where they are now, and what the cameras see."""
        return *self.moved.objects(scene), *self.voxels.objects.values()

    def ready(self, scene: Scene, objects: tuple[SceneObject, ...], openings: Openings = ()) -> ReadyScene:
        """A scene with its `objects` in place, reusing unchanged parts of the last world. Raises Unavailable."""
        model = self._with(scene, openings)
        world = self._world = World(objects, 0.0, self._store.meshes, self._world)
        allowed = world.with_allowed(scene.ignored_pairs)
        prepared = PlanningScene(scene.revision, model, allowed, ExactScene(model, allowed))
        return ReadyScene(objects, openings, prepared, prepared)

    def _with(self, scene: Scene, openings: Openings) -> RobotModel:
        """The robot with what it carries in a scene."""
        return self._carriers(scene.carried, scene.ignored_links, openings, scene.ignored_pairs)


@dataclass
class ReadyScene:
    """A scene without margins, with its objects in place and the grippers at these openings; and the same scene with the margins
    `used` last.
    """

    objects: tuple[SceneObject, ...]
    openings: Openings
    scene: PlanningScene
    used: PlanningScene

    def with_margins(self, margin: float, self_margin: float) -> PlanningScene:
        """The scene with a margin to objects and one between the robot's links (m)."""
        used = self.used
        if used.world.margin != margin or used.self_margin != self_margin:
            used = self.used = self.scene.with_margin(margin).with_self_margin(self_margin)
        return used

    def holds(self, scene: Scene, objects: tuple[SceneObject, ...], openings: Openings) -> bool:
        """Whether it belongs to this scene with exactly these objects and openings."""
        same = (
            openings == self.openings
            and len(objects) == len(self.objects)
            and all(map(operator.is_, objects, self.objects))
        )
        return same and scene.revision == self.scene.revision
