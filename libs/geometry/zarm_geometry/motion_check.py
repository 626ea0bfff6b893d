"""Whether timed motions of a robot keep a margin, in a world that changes."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import ArrayLike

from zarm_contract.messages import Attached, SceneObject
from zarm_geometry.allowed_collisions import Pairs
from zarm_geometry.meshes import Meshes
from zarm_geometry.robot_model import Openings, RobotModel
from zarm_geometry.situation import (
    MotionRobot,
    MotionVerdict,
    MotionWorld,
    MovableShapes,
    MovingObject,
    NearPair,
    Situation,
)
from zarm_geometry.world import World


class MotionCheck:
    """Checks motions of one robot in a changing world; any number of threads may check while one changes it.

    It computes on the exact shapes of robot and objects, without the GIL, see `kernels.first_contact`.
    """

    def __init__(self, model: RobotModel, meshes: Meshes | None = None) -> None:
        self.model, self._meshes = model, meshes or Meshes()
        self._robots: dict[tuple[tuple[Attached, ...], tuple[str, ...], Openings, Pairs], MotionRobot] = {}
        self._shapes: dict[int, MovableShapes] = {}  # by the id of the object in it
        self.set_world(World((), 0.0))

    def set_world(self, world: World) -> None:
        """From now on check in this world; its margin is not added to that of the checks."""
        self._world = MotionWorld.of(world)

    def update(self, changed: Sequence[SceneObject], removed: Sequence[str] = ()) -> None:
        """Put objects into the world, replacing those of the same names, and remove others; unknown names are ignored.

        This costs far less than a new world. But changed objects are not in its tree: after some hundreds a new world
        is faster.
        """
        self._world = self._world.updated([MovableShapes.of(item, self._meshes) for item in changed], removed)

    def situation(
        self,
        attached: Sequence[Attached] = (),
        ignored_links: Sequence[str] = (),
        moving: Sequence[MovingObject] = (),
        openings: Openings = (),
        allowed: Pairs = (),
    ) -> Situation:
        """The robot in the present world among `moving` objects, for several checks; `attached` objects and
        `ignored_links` are as in the scene, `openings` and `allowed` as in `RobotModel.with_attached`.
        """
        key = (tuple(attached), tuple(ignored_links), openings, allowed)
        robot = self._robots.get(key)
        if robot is None:
            robot = MotionRobot.of(self.model.with_attached(*key))
            self._robots = {key: robot}
        return self._world.situation(robot, self._shaped(moving) if moving else ())

    def check(
        self,
        times: ArrayLike,
        positions: ArrayLike,
        *,
        margin: float,
        attached: Sequence[Attached] = (),
        ignored_links: Sequence[str] = (),
        moving: Sequence[MovingObject] = (),
        openings: Openings = (),
        allowed: Pairs = (),
        acceleration: ArrayLike | None = None,
        self_collision: bool = True,
    ) -> MotionVerdict:
        """`Situation.check` in the present situation."""
        return self.situation(attached, ignored_links, moving, openings, allowed).check(
            times, positions, margin=margin, acceleration=acceleration, self_collision=self_collision
        )

    def nearby(
        self,
        position: ArrayLike,
        *,
        within: float,
        time: float = 0.0,
        attached: Sequence[Attached] = (),
        ignored_links: Sequence[str] = (),
        moving: Sequence[MovingObject] = (),
        openings: Openings = (),
        allowed: Pairs = (),
    ) -> list[NearPair]:
        """`Situation.nearby` in the present situation."""
        situation = self.situation(attached, ignored_links, moving, openings, allowed)
        return situation.nearby(position, within=within, time=time)

    def _shaped(self, moving: Sequence[MovingObject]) -> list[tuple[MovableShapes, MovingObject]]:
        """Moving objects with their shapes, which are remembered: the next check is often of the same ones."""
        known, used = self._shapes, dict[int, MovableShapes]()
        for each in moving:
            key = id(each.object)
            if key not in used:
                used[key] = known.get(key) or MovableShapes.of(each.object, self._meshes)
        if not used.keys() <= known.keys():
            self._shapes = used
        return [(used[id(each.object)], each) for each in moving]
