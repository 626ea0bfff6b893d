"""Aim, plan and move: the panel beside the gizmo."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any

import numpy as np
from pydantic import ValidationError
from viser import Icon
from viser.transforms import SE3, SO3

from zarm.motions import Goal as Target
from zarm.values import Pose, invalid, pose_of
from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Plan
from zarm_trajectory.trajectory import TimedTrajectory
from zarm_viewer.aim import Goal
from zarm_viewer.arm import REDRAW_THRESHOLD
from zarm_viewer.controls import button, changed, put
from zarm_viewer.kinematics import message_of
from zarm_viewer.named_poses import NamedPoses
from zarm_viewer.panel_context import PanelContext
from zarm_viewer.plan_options import PlanOptions
from zarm_viewer.watching import News
from zarm_viewer.way_options import WayOptions
from zarm_viewer.waypoints import WaypointHandles

NO_GOAL = "Drag the handle at the tip, or choose a pose."
"""Shown until a goal has been chosen."""


class MotionPanel:
    """Buttons that plan and move, joint sliders, numbers, named poses, options, and scrubbing through a plan.

    `forget_plan` removes the last plan from the rest of the page, when the next one is asked for.
    """

    def __init__(self, panels: PanelContext, goal: Goal, poses: NamedPoses, forget_plan: Callable[[], object]) -> None:
        self._panels, self._goal, self._poses, self._forget_plan = panels, goal, poses, forget_plan
        self._plan: Plan | None = None
        self._timed: TimedTrajectory | None = None
        self._shown = 0
        self._tools: tuple[str, ...] = ()
        gui = panels.server.gui
        self._say = gui.add_markdown(NO_GOAL)
        button(self._panels, "Plan", Icon.ROUTE, self._plan_it)
        button(self._panels, "Execute", Icon.PLAYER_PLAY, self._execute, moves=True)
        button(self._panels, "Plan and execute", Icon.PLAYER_TRACK_NEXT, self._plan_and_execute, moves=True)
        self._scrub = gui.add_slider("time (s)", 0.0, 1.0, 0.01, 0.0, disabled=True, hint="Look through the plan")
        changed(panels, self._scrub, "look through the plan", self._scrub_to)
        robot = panels.robot
        self._group("motion", {"Pause": robot.pause, "Resume": robot.resume, "Cancel": robot.cancel})
        self._speed = gui.add_slider("speed", 0.05, 1.0, 0.05, 1.0)
        changed(panels, self._speed, "speed", lambda: robot.speed(self._speed.value))
        self._strategy = gui.add_dropdown("strategy", ["-"])
        changed(panels, self._strategy, "strategy", lambda: robot.strategy(self._strategy.value))
        self._branch = gui.add_dropdown("branch", ["1"], visible=False)
        changed(panels, self._branch, "branch", self._choose_branch)
        if len(panels.groups) > 1:
            self._add_groups()
        with gui.add_folder("Poses", expand_by_default=False):
            self._add_poses()
        with gui.add_folder("Joints (deg)", expand_by_default=False):
            self._add_joints()
        with gui.add_folder("Tip", expand_by_default=False):
            self._add_numbers()
        with gui.add_folder("Waypoints", expand_by_default=False) as folder:
            self._waypoints = WaypointHandles(panels, folder)
            self._add_waypoints()
        with gui.add_folder("Way", expand_by_default=False):
            self._way = WayOptions(panels)
        with gui.add_folder("Options", expand_by_default=False):
            self._options = PlanOptions(panels)

    def draw(self, news: News) -> None:
        """Show what has changed."""
        if news.state is not None:
            put(self._speed, news.state.speed_scale)
        if news.strategies is not None:
            self._strategy.options = [each.name for each in news.strategies.strategies if each.available] or ["-"]
            put(self._strategy, news.strategies.active)
        if news.planners is not None:
            self._options.offer(news.planners.names)
        if news.plan is not None:
            self._take(news.plan)
        if news.scene is not None and news.scene.tools != self._tools:
            self._tools = news.scene.tools
            self._goal.forget()  # it was one of another tip
        elif news.scene is not None:
            self._goal.check_again()
        if self._goal.revision != self._shown:
            self._shown = self._goal.revision
            self._draw_goal()
        self._goal.follow()

    def chosen(self, yes: bool) -> None:
        """Show or hide the handles in the 3D view."""
        self._goal.show(gizmo=yes)
        self._waypoints.show(yes)

    # -- what is on it --

    def _add_groups(self) -> None:
        choice = self._panels.server.gui.add_dropdown("group", self._panels.groups, initial_value=self._panels.group)

        def choose() -> None:
            self._panels.choose(choice.value)
            self._goal.forget()

        changed(self._panels, choice, "group", choose)

    def _add_poses(self) -> None:
        gui = self._panels.server.gui
        choice = gui.add_dropdown("pose", self._poses.names())
        button(self._panels, "Aim there", Icon.TARGET, lambda: self._aim_at(np.array(self._poses.joints(choice.value))))
        button(self._panels, "Home", Icon.HOME, lambda: self._aim_at(np.array(self._poses.joints("home"))))
        button(self._panels, "Back to the robot", Icon.ARROW_BACK_UP, self._goal.forget)
        name = gui.add_text("name", "here")

        def keep() -> None:
            branch = self._goal.now.branch
            joints = self._panels.joints if branch is None else branch.joints
            try:
                self._poses.keep(name.value, tuple(joints.tolist()))
            except ValidationError as error:
                raise invalid("the name", error) from None
            choice.options = self._poses.names()
            put(choice, name.value)

        def remove() -> None:
            self._poses.remove(choice.value)
            choice.options = self._poses.names()

        button(self._panels, "Keep the goal under this name", Icon.BOOKMARK, keep)
        button(self._panels, "Remove the pose", Icon.TRASH, remove)

    def _add_joints(self) -> None:
        robot, gui = self._panels.description, self._panels.server.gui
        lower, upper = robot.range_about(self._panels.joints.tolist())
        self._sliders = [
            gui.add_slider(joint, *_degrees(low, high), 0.1, float(np.degrees(at)))
            for joint, low, high, at in zip(robot.descriptor.joints, lower, upper, self._panels.joints, strict=True)
        ]

        def slide() -> None:
            self._goal.at(np.radians([slider.value for slider in self._sliders]))

        for slider in self._sliders:
            changed(self._panels, slider, "joints", slide)

    def _add_numbers(self) -> None:
        gui = self._panels.server.gui
        self._position = gui.add_vector3("xyz (m)", (0.0, 0.0, 0.0), step=0.001)
        self._turn = gui.add_vector3("rpy (deg)", (0.0, 0.0, 0.0), step=0.1)

        def aim() -> None:
            turn = SO3.from_rpy_radians(*np.radians(self._turn.value))
            pose = SE3.from_rotation_and_translation(turn, np.array(self._position.value))
            self._goal.gizmo.position, self._goal.gizmo.wxyz = pose.translation(), turn.wxyz
            self._goal.reach(pose)

        for numbers in (self._position, self._turn):
            changed(self._panels, numbers, "tip", aim)

    def _add_waypoints(self) -> None:
        self._panels.server.gui.add_markdown(
            "The tip passes them on its way to the goal. Drag each to where it is wanted."
        )
        button(self._panels, "Add one here", Icon.MAP_PIN_PLUS, lambda: self._waypoints.add(self._goal.now.pose))
        button(self._panels, "Forget them", Icon.MAP_PIN_OFF, self._waypoints.clear)

    def _group(self, label: str, actions: dict[str, Callable[[], object]]) -> None:
        group = self._panels.server.gui.add_button_group(label, list(actions))

        @group.on_click
        def _(event: Any) -> None:
            self._panels.attempt(group.value, actions[group.value], event.client)

    # -- what it does --

    def _aim_at(self, joints: np.ndarray[Any, np.dtype[np.float64]]) -> None:
        self._goal.at(joints)

    def _target(self, pose: Pose) -> Target | None:
        """The goal: of the joints that move with the group, unless others are to move too. None where a program leads to the pose."""
        aim, through = self._goal.now, self._waypoints.passed
        if through or self._way.in_use or self._options.to_pose or aim.branch is None:
            return self._way.chosen.target(through, pose)
        joints = aim.branch.joints
        return tuple((joints[self._panels.moving] if self._of_group() else joints).tolist())

    def _of_group(self) -> bool:
        """Whether only the joints of the group are to move."""
        branch, others = self._goal.now.branch, np.ones(len(self._panels.joints), np.bool_)
        others[self._panels.moving] = False
        return branch is None or bool(np.all(np.abs(branch.joints - self._panels.joints)[others] < REDRAW_THRESHOLD))

    def _plan_it(self) -> Plan:
        self._plan = None  # if planning fails, the previous plan must neither be executed nor be shown
        self._scrub.disabled = True
        self._forget_plan()
        options, robot = self._options, self._panels.robot
        group = self._panels.group if self._of_group() else None
        pose = pose_of(message_of(self._goal.now.pose))
        target = self._target(pose)
        if target is None:
            plan = robot.plan_program(
                self._way.chosen.segments(self._waypoints.passed, pose, group), **options.of_program
            )
        else:
            plan = robot.plan(target, path_constraint=options.path_constraint, group=group, **options.settings)
        self._take(plan)
        return plan

    def _take(self, plan: Plan) -> None:
        """Make this plan, whoever made it, the one to scrub through and execute, since its path is the one drawn."""
        self._timed = TimedTrajectory.of(plan.trajectory, self._panels.description.descriptor.joints)
        self._plan = plan
        self._scrub.max, self._scrub.disabled = round(self._timed.duration, 2), False
        put(self._scrub, 0.0)

    def _execute(self) -> None:
        if self._plan is None:
            raise InvalidRequest("there is no plan; press Plan first")
        self._start(self._plan)

    def _plan_and_execute(self) -> None:
        self._start(self._plan_it())

    def _start(self, plan: Plan) -> None:
        self._panels.robot.start(plan, replan=self._options.replan)
        self._goal.forget()

    def _choose_branch(self) -> None:
        self._goal.choose(int(self._branch.value.split()[0]) - 1)

    def _scrub_to(self) -> None:
        if self._timed is not None:
            self._goal.preview(self._timed.at(self._scrub.value)[0])

    def _draw_goal(self) -> None:
        aim, aimed = self._goal.now, self._goal.aimed
        put(self._say, aim.describe() if aimed else NO_GOAL, "content")
        options = [f"{at + 1} {'collides' if each.in_collision else 'free'}" for at, each in enumerate(aim.branches)]
        if options and list(self._branch.options) != options:
            self._branch.options = options
        if options:
            put(self._branch, options[aim.chosen])
        self._branch.visible = len(options) > 1
        if aim.branch is not None or not aimed:
            joints = self._panels.joints if aim.branch is None else aim.branch.joints
            for slider, value in zip(self._sliders, np.degrees(joints), strict=True):
                with contextlib.suppress(ValueError):
                    put(slider, round(float(np.clip(value, slider.min, slider.max)), 1))
        put(self._position, tuple(np.round(aim.pose.translation(), 4).tolist()))
        put(self._turn, tuple(np.round(np.degrees(tuple(aim.pose.rotation().as_rpy_radians())), 2).tolist()))


def _degrees(low: float, high: float) -> tuple[float, float]:
    """Limits for a slider, rounded inwards."""
    return float(np.ceil(np.degrees(low) * 10) / 10), float(np.floor(np.degrees(high) * 10) / 10)
