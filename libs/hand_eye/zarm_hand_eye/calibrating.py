"""The calibration of one camera: the robot moves, the camera looks at a board, and its pose follows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from zarm import PoseGoal, TipFrame
from zarm.robot import Robot
from zarm_contract.errors import DeadlineExceeded, InvalidRequest, PlanningFailed, Unavailable
from zarm_contract.messages import Camera, Intrinsics
from zarm_geometry.frames import matrix, pose_of
from zarm_hand_eye.board import Board, View
from zarm_hand_eye.solving import Solution, solve
from zarm_hand_eye.viewpoints import viewpoints
from zarm_runtime import clock
from zarm_trajectory.arrays import Array

MIN_VIEWS = 5
"""Views without which the pose is not determined well."""
MOST_ERROR = 2.0
"""Largest reprojection error (pixels, RMS) of a calibration that counts."""
_SETTLE = 0.5
"""s from the end of a motion until the arm rests, as the camera sees it."""
_TRIES = 6
"""Viewpoints that are tried for each that is needed."""
_ENOUGH = 8
"""Views whose solution tells better than the declaration where camera and board are."""


@dataclass(frozen=True)
class Calibration:
    """A `camera` where it was found to be, from so many `views`; in hand, or beside the robot in the frame of its base.

    `reprojection_error` is the RMS distance (pixels) of the board's corners from where they should be in the images. `position_std` (m) and `angle_std` (rad) are the standard deviations
    of the pose that follow from it.
    """

    camera: Camera
    views: int
    reprojection_error: float
    position_std: float
    angle_std: float


def calibrate(
    robot: Robot,
    camera: str,
    board: Board | None = None,
    *,
    views: int = 15,
    board_link: str | None = None,
    velocity_scale: float = 0.5,
    seed: int = 0,
    report: Callable[[str], object] = lambda _: None,
) -> Calibration:
    """Find out where a camera is, and tell the robot's perception.

    The camera sees the board now, and is declared about where it is. On a link that the joints move it looks at a board that stands still; elsewhere it is declared in the frame of
    the base, and the board is fixed to `board_link`. The robot moves through `views` poses around the present one, each planned, and
    back. `report` is told what happens.

    Raises InvalidRequest for a camera that cannot be calibrated, or whose images contradict each other by more than MOST_ERROR, and leaves it where it was; Unavailable where it sees no board or too few poses are reached, and what planning and execution raise.
    """
    if views < MIN_VIEWS:
        raise InvalidRequest(f"{views} views do not determine the pose; use {MIN_VIEWS} or more", field="views")
    cell = _Cell.of(robot, camera, board or Board(), board_link)
    start = robot.joint_state().position
    cell.look()
    if not cell.seen:
        raise Unavailable(
            f"the camera {camera} sees no board; move the arm until it sees all of it, and check its squares and dictionary"
        )
    report("the board is seen")
    random_views = viewpoints(cell.seen[0].view.board, cell.board, cell.intrinsics, seed)
    for _ in range(_TRIES * views):
        if len(cell.seen) >= views:
            break
        try:
            plan = robot.plan(cell.goal(next(random_views)), velocity_scale=velocity_scale)
        except (PlanningFailed, DeadlineExceeded):
            continue
        robot.execute(plan)
        if cell.look():
            report(f"view {len(cell.seen)} of {views}")
    robot.execute(robot.plan(start, velocity_scale=velocity_scale))
    if len(cell.seen) < views:
        raise Unavailable(
            f"the board is seen from {len(cell.seen)} of {views} poses that can be reached; begin where the arm has room on all sides and the board fills half of the image"
        )
    solved = cell.solved()
    if solved.reprojection_error > MOST_ERROR:
        raise InvalidRequest(
            f"the reprojection error is {solved.reprojection_error:.1f} pixels, so {camera} stays where it was; see that the board does not move or bend, that its squares have "
            "the size that is stated, and that the intrinsics are those of the images",
            field="board",
        )
    found = cell.camera.model_copy(update=_fields(solved.camera))
    robot.perception.add(found)
    return Calibration(found, len(cell.seen), solved.reprojection_error, solved.position_std, solved.angle_std)


@dataclass(frozen=True)
class _Seen:
    """A view, and the link (4, 4) that moves camera or board in the frame of the base."""

    link: Array
    view: View


@dataclass
class _Cell:
    """A camera and a board, of which the one is on the robot's `link` and the other stands still, and what was seen so far."""

    robot: Robot
    camera: Camera
    intrinsics: Intrinsics
    board: Board
    link: str
    in_hand: bool
    seen: list[_Seen] = field(default_factory=list)

    @classmethod
    def of(cls, robot: Robot, name: str, board: Board, board_link: str | None) -> _Cell:
        cameras = {one.name: one for one in robot.perception.cameras()}
        if name not in cameras:
            raise InvalidRequest(f"there is no camera {name}; there are {', '.join(cameras) or 'none'}", field="camera")
        camera = cameras[name]
        if camera.projection != "pinhole" or camera.intrinsics is None:
            raise InvalidRequest(f"{name} has no intrinsics of a pinhole camera; declare them", field="camera")
        in_hand = camera.link is not None and _moves(robot, camera.link)
        if not in_hand and board_link is None:
            raise InvalidRequest(f"{name} is not on the arm; name the link that carries the board", field="board_link")
        if not in_hand and camera.link is not None:
            raise InvalidRequest(
                f"{name} is declared in the frame of {camera.link}; leave the link out: declare it in that of the base",
                field="camera",
            )
        if in_hand and board_link is not None:
            raise InvalidRequest(f"{name} is on the arm, so the board stands still; leave this out", field="board_link")
        return cls(robot, camera, camera.intrinsics, board, (camera.link if in_hand else board_link) or "", in_hand)

    def look(self) -> bool:
        """Look at the board with the robot at rest; whether it is seen."""
        image = self.robot.perception.color(self.camera.name, after=clock.unix_time() + _SETTLE)
        link = self.robot.fk([self.robot.joint_state().position], tip=self.link)[0]
        view = self.board.find(image, self.intrinsics)
        if view is not None:
            self.seen.append(_Seen(matrix(link.position, link.orientation), view))
        return view is not None

    def goal(self, seen: Array) -> PoseGoal:
        """The goal at which the camera sees the board (4, 4) in its frame as in `seen`."""
        camera, board = self._guess()
        if self.in_hand:
            return PoseGoal(pose_of(board @ np.linalg.inv(seen)), tip=TipFrame(self.link, pose_of(camera)))
        return PoseGoal(pose_of(camera @ seen), tip=TipFrame(self.link, pose_of(board)))

    def solved(self) -> Solution:
        """Camera and board as all views say."""
        places: list[Array] = [
            one.link if self.in_hand else np.asarray(np.linalg.inv(one.link), np.float64) for one in self.seen
        ]
        return solve(places, [one.view for one in self.seen], self.intrinsics)

    def _guess(self) -> tuple[Array, Array]:
        """Camera and board as far as they are known by now."""
        if len(self.seen) >= _ENOUGH:
            solved = self.solved()
            return solved.camera, solved.board
        camera, first = matrix(self.camera.position, self.camera.orientation), self.seen[0]
        if self.in_hand:
            return camera, first.link @ camera @ first.view.board
        return camera, np.linalg.inv(first.link) @ camera @ first.view.board


def _moves(robot: Robot, link: str) -> bool:
    """Whether the joints move a link."""
    try:
        robot.fk([robot.joint_state().position], tip=link)
    except InvalidRequest:
        return False
    return True


def _fields(frame: Array) -> dict[str, object]:
    pose = pose_of(frame)
    return {"position": pose.position, "orientation": pose.orientation}
