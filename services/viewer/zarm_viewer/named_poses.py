"""Joint positions that have a name, kept in a file of the viewer's."""

from __future__ import annotations

from pathlib import Path

from zarm_contract.messages import Joints, Message, Name
from zarm_runtime.state_file import StateFile


class Poses(Message):
    """Joint positions (rad) by name."""

    poses: dict[Name, Joints]


class NamedPoses:
    """The named poses of one robot; `home` is always among them."""

    def __init__(self, folder: Path, robot: str, home: tuple[float, ...]) -> None:
        self._file = StateFile(folder / f"poses-{robot}.json", Poses)
        self._home = home
        loaded = self._file.load()
        self._poses = dict(loaded.poses) if loaded else {}

    def names(self) -> tuple[str, ...]:
        """Of all, home first."""
        return ("home", *sorted(self._poses.keys() - {"home"}))

    def joints(self, name: str) -> tuple[float, ...]:
        """Those of a pose (rad); of one that is gone, home."""
        return self._home if name == "home" else self._poses.get(name, self._home)

    def keep(self, name: str, joints: tuple[float, ...]) -> None:
        """Keep joint positions under a name. Raises Unavailable where the file cannot be written."""
        poses = Poses(poses={**self._poses, name: joints})
        self._file.save(poses)
        self._poses = dict(poses.poses)
