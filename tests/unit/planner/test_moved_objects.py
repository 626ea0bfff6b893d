"""The planner plans around moving objects where they were told to be last."""

from __future__ import annotations

from zarm_contract.messages import Cuboid, ObjectPose, Scene, Sphere
from zarm_planner.scene.moved_objects import MovedObjects

BOX = Cuboid(kind="cuboid", name="box", position=(1.0, 0.0, 0.0), size=(0.2, 0.2, 0.2))
BALL = Sphere(kind="sphere", name="ball", position=(0.0, 1.0, 0.0), radius=0.1)
SCENE = Scene(revision="1-5be0c1d2f3a4", objects=(BOX, BALL))
KEY = "zarm/arm/scene/object/{}/pose"


def pose(stamp: float, x: float) -> ObjectPose:
    return ObjectPose(stamp=stamp, position=(x, 0.0, 0.0), speed=0.1)


def test_an_object_is_at_its_newest_pose_until_edited() -> None:
    scene = SCENE
    moved = MovedObjects(lambda: scene)
    assert moved.objects(scene) is scene.objects
    moved.receive(KEY.format("box"), pose(2.0, 0.5))
    moved.receive(KEY.format("box"), pose(1.0, 0.7))
    moved.receive(KEY.format("ball"), pose(1.0, 0.3))
    moved.receive(KEY.format("chair"), pose(1.0, 0.3))
    placed = moved.objects(scene)
    assert [item.position[0] for item in placed] == [0.5, 0.3]
    assert moved.objects(scene) is placed
    scene = Scene(revision="2-5be0c1d2f3a4", objects=(BOX.model_copy(), BALL))
    assert [item.position[0] for item in moved.objects(scene)] == [1.0, 0.3]
