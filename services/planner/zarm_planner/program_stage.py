"""The surroundings of a program's segments: the scene as the program has changed it."""

from __future__ import annotations

from collections.abc import Callable, Collection

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import AttachObject, Grip, PlannedGrip, PlannerSettings, ProgramRequest
from zarm_geometry.gripper_openings import GripperOpenings
from zarm_geometry.robot_model import RobotModel
from zarm_planner.context import PlanningContext
from zarm_planner.deadline import Deadline
from zarm_planner.programs import Scales, SceneChange
from zarm_planner.scene.attached_objects import attach, carrier, check_attach, detach
from zarm_planner.scene.scene_cache import ReadyScene, SceneCache
from zarm_planner.scene.store import SceneStore
from zarm_planner.scene.tools import at_tool
from zarm_planner.stage_timer import StageTimer
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits


class ProgramStage:
    """See `programs.Stage`. `revision` is that of the scene, and `openings` are those of the grippers, at the start."""

    def __init__(
        self,
        model: RobotModel,
        store: SceneStore,
        scenes: SceneCache,
        limits: Callable[[float, float], Limits],
        settings: PlannerSettings,
        request: ProgramRequest,
        deadline: Deadline,
        grippers: GripperOpenings,
    ) -> None:
        self._grippers = grippers
        self._openings = self.openings = grippers.chosen(request.openings)
        self.robot = model.robot.with_tools(store.scene.tools)
        self._model, self._store, self._scenes, self._limits = model, store, scenes, limits
        self._settings, self._request, self._deadline = settings, request, deadline
        self._scene = store.scene
        self.revision = self._scene.revision
        self.timer = StageTimer()
        self._changed: ReadyScene | None = None

    def context(self, scales: Scales, touch: Collection[str] = ()) -> PlanningContext:
        """See `programs.Stage`."""
        request, settings, given = self._request, self._settings, self._request.self_margin
        self_margin = self._model.robot.descriptor.self_margin if given is None else given
        margin = settings.margin if request.margin is None else request.margin
        if touch:
            scene = self._without(touch).with_margins(margin, self_margin)
        elif self._changed is None:
            scene = self._scenes.present(margin, self_margin, self._openings)
        else:
            scene = self._changed.with_margins(margin, self_margin)
        limits = self._limits(
            scales[0] or request.velocity_scale or settings.velocity_scale,
            scales[1] or request.acceleration_scale or settings.acceleration_scale,
        )
        return PlanningContext(
            scene=scene,
            limits=limits,
            deadline=self._deadline,
            max_attempts=request.max_attempts or settings.max_attempts,
            seed=request.seed,
            timer=self.timer,
        )

    def change(self, change: SceneChange, q: Array) -> None:
        """See `programs.Stage`."""
        if isinstance(change, AttachObject):
            change = at_tool(self._model.robot, self._scene, change)
        tip = self._model.fk_link(carrier(self._model, self._scene, change), q)
        if isinstance(change, AttachObject):
            check_attach(self._model.links, change.name, change.touch_links, "edit")
            self._scene = attach(self._scene, change, tip, self._store.meshes)
        else:
            self._scene = detach(self._scene, change, tip)
        self._changed = self._scenes.ready(self._scene, self._scenes.objects(self._scene), self._openings)

    def grip(self, grip: Grip) -> PlannedGrip:
        """See `programs.Stage`."""
        name = self._grippers.named(grip.gripper, "gripper")
        self._grippers.check(name, grip.width, "width")
        self._openings = tuple((one, grip.width if one == name else width) for one, width in self._openings)
        self._changed = self._scenes.ready(self._scene, self._scenes.objects(self._scene), self._openings)
        return PlannedGrip(gripper=name, width=grip.width, force=grip.force, speed=grip.speed, tolerance=grip.tolerance)

    def _without(self, names: Collection[str]) -> ReadyScene:
        """The scene without some of its objects."""
        objects = self._scenes.objects(self._scene)
        if missing := set(names) - {item.name for item in objects}:
            raise InvalidRequest(
                f"there is no object {', '.join(sorted(missing))} in the scene to touch; the scene holds "
                f"{', '.join(item.name for item in objects) or 'none'}",
                field="touch",
            )
        return self._scenes.ready(
            self._scene, tuple(item for item in objects if item.name not in names), self._openings
        )
