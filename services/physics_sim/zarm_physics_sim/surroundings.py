"""The surroundings of the robot, as scene and world change."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from zarm_contract.messages import LoadWorld, Nothing, PhysicsObjects, Scene
from zarm_contract.messages.physics import MAX_BODIES
from zarm_physics_sim.arm import PhysicalArm
from zarm_physics_sim.cameras import SimulatedCameras
from zarm_physics_sim.world import World

log = logging.getLogger(__name__)


class Surroundings:
    """Puts an arm into a world, or if that is empty into the scene, which otherwise is what the planner believes.

    `publish` says what is there.
    """

    def __init__(
        self, arm: PhysicalArm, cameras: SimulatedCameras, world: World, publish: Callable[[PhysicsObjects], object]
    ) -> None:
        self._arm, self._cameras, self._world, self._scene = arm, cameras, world, Scene(revision="0-000000000000")
        self._publish = publish
        self._lock = threading.Lock()
        publish(_published(world))

    def see(self, scene: Scene) -> None:
        """Take over a new scene."""
        with self._lock:
            self._scene = scene
            self._change()

    def load(self, request: LoadWorld) -> Nothing:
        """Replace the world, or add to it. Raises InvalidRequest."""
        world = World.of(request)
        with self._lock:
            self._world = self._world.joined(world) if request.add else world
            self._change()
        log.info("world loaded objects=%d", len(self._world.objects))
        return Nothing()

    def _change(self) -> None:
        world = self._world.of_scene(self._scene.objects)
        if meshes := [item.name for item in world.objects.values() if item.kind == "mesh"]:
            log.warning("meshes are left out of the physics objects=%s", ",".join(meshes))
        self._arm.change_world(world, self._scene.attached, self._cameras.prepare)
        self._publish(_published(world))


def _published(world: World) -> PhysicsObjects:
    """What is there besides the scene, or where it moves."""
    objects = () if world.believed else tuple(world.objects.values())
    return PhysicsObjects(objects=objects[:MAX_BODIES])
