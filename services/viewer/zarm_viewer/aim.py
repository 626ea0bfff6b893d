"""The goal in the 3D view: a gizmo at the tip, and the ghost of the robot at that pose.

The planner's inverse kinematics answer during a drag; only the newest pose is requested.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from viser import ClientHandle, TransformControlsEvent
from viser.transforms import SE3

from zarm_contract.errors import ZarmError
from zarm_contract.messages import IkRequest
from zarm_trajectory.arrays import Array
from zarm_viewer.arm import REDRAW_THRESHOLD, Arm, Ghost
from zarm_viewer.kinematics import message_of, pose_at
from zarm_viewer.panel_context import PanelContext

FREE, COLLIDING, UNREACHABLE = (64, 192, 87), (240, 62, 62), (134, 142, 150)
DRAGGED, BRANCHES = 8, 64
"""Most solutions requested during a drag, and after it, when it is all that the planner gives."""
RESTS = 0.3
"""Seconds without movement after which a drag has ended."""
_SECONDS = 1.0  # time limit (s) for an answer, since the user is dragging


@dataclass(frozen=True)
class Branch:
    """Joint positions (J,) in rad that reach the pose, and what they would collide with, if anything."""

    joints: Array
    touching: tuple[str, str] | None = None
    in_collision: bool = False


@dataclass(frozen=True)
class Aim:
    """The goal. `branches` reach `pose`, and `chosen` is shown; there are none if it is unreachable. Free ones come
    first, and among these the nearest to where the ghost was.
    """

    pose: SE3
    branches: tuple[Branch, ...]
    chosen: int = 0
    fault: str = ""

    @property
    def branch(self) -> Branch | None:
        """The branch that is shown."""
        return self.branches[self.chosen] if self.branches else None

    def describe(self) -> str:
        """A description in Markdown."""
        if self.fault:
            return f"**{self.fault}**"
        branch = self.branch
        if branch is None:
            return "**unreachable**: no joint positions reach it"
        many = f"branch {self.chosen + 1} of {len(self.branches)} · " if len(self.branches) > 1 else ""
        if branch.in_collision:
            return f"{many}**collision** of {' and '.join(branch.touching or ())}"
        return f"{many}reachable, free"


class Goal:
    """The goal that users aim with. It follows the robot until someone moves it."""

    def __init__(self, panels: PanelContext) -> None:
        self._panels = panels
        scene = panels.server.scene
        self._ghost = Ghost(
            lambda: Arm(scene, f"{panels.root}/goal_ghost", panels.description, panels.body, FREE, opacity=0.45)
        )
        self.gizmo = scene.add_transform_controls(f"{panels.root}/goal", scale=0.3, line_width=3.0, depth_test=False)
        self._changed = threading.Condition()
        self._wanted: tuple[SE3 | Array, Array] | None = None
        self._aim = Aim(panels.chain.tip(panels.joints), ())
        self._place_gizmo(self._aim.pose)
        self._sought: SE3 | Array = self._aim.pose
        self.aimed = False
        """Whether a user has chosen a goal; until then the gizmo stays at the tip."""
        self.dragged: Callable[[SE3, ClientHandle | None], object] = lambda *_: None
        """Called with each pose of the gizmo during a drag, and with the page on which it happens."""
        self.revision = 0
        """Increases with every change shown in the panels: goals, and the robot's rest position while there is no goal.
        """
        self._followed: Array | None = None
        self._rests = False
        threading.Thread(target=self._solve, name="ik", daemon=True).start()

        @self.gizmo.on_update
        async def _(event: TransformControlsEvent) -> None:
            pose = pose_at(event.target)
            self.dragged(pose, event.client)
            self.reach(pose)

    @property
    def now(self) -> Aim:
        """The present goal."""
        return self._aim

    def reach(self, pose: SE3) -> None:
        """Aim at a pose of the tip."""
        self._want(pose)

    def at(self, joints: Array) -> None:
        """Aim at joint positions (J,) in rad."""
        self._place_gizmo(self._panels.chain.tip(joints))
        self._want(joints)

    def check_again(self) -> None:
        """Look anew for what the goal would collide with, since the scene has changed."""
        with self._changed:
            if self.aimed:
                self._wanted = self._sought, self._near()
                self._changed.notify()

    def choose(self, branch: int) -> None:
        """Show another solution, by its index."""
        if branch < len(self._aim.branches):
            self._show(replace(self._aim, chosen=branch))

    def forget(self) -> None:
        """Drop the goal: the gizmo returns to the tip and stays with it."""
        self.aimed = False
        self._followed = None
        self._ghost.hide()
        self.follow()

    def follow(self) -> None:
        """Follow the robot if no goal has been chosen."""
        if self.aimed:
            return
        joints = self._panels.joints
        if self._followed is None or np.abs(joints - self._followed).max() > REDRAW_THRESHOLD:
            pose = self._panels.chain.tip(joints)
            self._place_gizmo(pose)
            self._aim = Aim(pose, ())
            self._followed, self._rests = joints, False
        elif not self._rests:  # numbers change only when the robot rests: each frame's would be sent to every page
            self._rests = True
            self.revision += 1

    def preview(self, joints: Array) -> None:
        """Show the ghost at joint positions (J,) along a plan, as when the user scrubs through it."""
        self._ghost.show(joints)
        self._ghost.paint(FREE)

    def show(self, *, gizmo: bool) -> None:
        """Show or hide the gizmo."""
        self.gizmo.visible = gizmo
        if not gizmo:
            self._ghost.hide()

    def _want(self, wanted: SE3 | Array) -> None:
        with self._changed:
            self.aimed, self._sought = True, wanted
            self._wanted = wanted, self._near()
            self._changed.notify()

    def _near(self) -> Array:
        """The joint positions to which the next solutions should be near: those shown."""
        branch = self._aim.branch
        return self._panels.joints if branch is None else branch.joints

    def _solve(self) -> None:
        dragged: SE3 | None = None
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._wanted is not None, None if dragged is None else RESTS)
                wanted, self._wanted = self._wanted, None
            if wanted is not None:
                what, near = wanted
                dragged = what if isinstance(what, SE3) else None
                self._find(what, near, DRAGGED)
            elif dragged is not None:
                self._find(dragged, self._near(), BRANCHES)
                dragged = None

    def _find(self, what: SE3 | Array, near: Array, most: int) -> None:
        pose = what if isinstance(what, SE3) else self._panels.chain.tip(what)
        try:
            found = self._branches(pose, near, most) if isinstance(what, SE3) else self._checked([tuple(what.tolist())])
            aim = Aim(pose, found)
        except ZarmError as error:
            aim = Aim(pose, (), fault=str(error))
        if self.aimed:
            self._show(aim)

    def _branches(self, pose: SE3, near: Array, most: int) -> tuple[Branch, ...]:
        request = IkRequest(
            poses=(message_of(pose),),
            group=self._panels.group,
            near=tuple(near.tolist()),
            max_solutions=most,
            collision_free=False,
        )
        solutions = self._panels.robot.request_ik(request, timeout=_SECONDS).solutions[0]
        found = np.tile(near, (len(solutions), 1))
        if solutions:
            found[:, self._panels.moving] = solutions

        def turns(branch: Branch) -> tuple[bool, float]:
            return branch.in_collision, float(np.abs(branch.joints - near).max())

        return tuple(sorted(self._checked([*map(tuple, found.tolist())]), key=turns))

    def _checked(self, solutions: list[tuple[float, ...]]) -> tuple[Branch, ...]:
        if not solutions:
            return ()
        results = self._panels.robot.check(solutions, timeout=_SECONDS)
        return tuple(
            Branch(np.array(joints), result.pair, result.in_collision)
            for joints, result in zip(solutions, results, strict=True)
        )

    def _show(self, aim: Aim) -> None:
        branch = aim.branch
        with self._panels.server.atomic():
            if branch is not None:
                self._ghost.show(branch.joints)
            self._ghost.paint(UNREACHABLE if branch is None else COLLIDING if branch.in_collision else FREE)
        self._aim = aim
        self.revision += 1

    def _place_gizmo(self, pose: SE3) -> None:
        self.gizmo.position = pose.translation()
        self.gizmo.wxyz = pose.rotation().wxyz
