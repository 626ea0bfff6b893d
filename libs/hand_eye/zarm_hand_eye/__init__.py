"""Hand-eye calibration: where a camera is, on the robot or beside it, from views of a printed board."""

from zarm_hand_eye.board import Board
from zarm_hand_eye.calibrating import Calibration, calibrate

__all__ = ["Board", "Calibration", "calibrate"]
