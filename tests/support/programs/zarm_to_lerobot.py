"""`zarm-to-lerobot` with the real lerobot package, and nothing behind what a data set does not need."""

from __future__ import annotations

from lerobot_left_out import OTHERS, leave_out

leave_out(OTHERS)

from lerobot_robot_zarm.dataset import main  # noqa: E402

main()
