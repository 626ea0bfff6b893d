"""Named poses stay in their file, and home is always among them."""

from __future__ import annotations

from pathlib import Path

import pytest

from zarm_contract.errors import InvalidRequest
from zarm_viewer.named_poses import NamedPoses

HOME, SHELF = (0.0, 1.0), (0.5, -0.5)


def test_a_kept_pose_is_there_until_removed(tmp_path: Path) -> None:
    NamedPoses(tmp_path, "arm", HOME).keep("shelf", SHELF)
    poses = NamedPoses(tmp_path, "arm", HOME)
    assert poses.names() == ("home", "shelf")
    assert poses.joints("shelf") == SHELF
    poses.remove("shelf")
    assert NamedPoses(tmp_path, "arm", HOME).names() == ("home",)


def test_home_is_not_removed(tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest):
        NamedPoses(tmp_path, "arm", HOME).remove("home")
