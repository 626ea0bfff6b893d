"""Named joint positions, saved in a file of the viewer."""

from __future__ import annotations

from pathlib import Path

from zarm_contract.errors import InvalidRequest
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
        """All names, home first."""
        return ("home", *sorted(self._poses.keys() - {"home"}))

    def joints(self, name: str) -> tuple[float, ...]:
        """The joints of a pose (rad); those of home if it is gone."""
        return self._home if name == "home" else self._poses.get(name, self._home)

    def remove(self, name: str) -> None:
        """Delete a pose. Raises InvalidRequest for home, and Unavailable if the file cannot be written."""
        if name == "home":
            raise InvalidRequest("home is the descriptor's and stays", field="pose")
        self._save(Poses(poses={each: joints for each, joints in self._poses.items() if each != name}))

    def keep(self, name: str, joints: tuple[float, ...]) -> None:
        """Save joint positions under a name. Raises Unavailable if the file cannot be written."""
        self._save(Poses(poses={**self._poses, name: joints}))

    def _save(self, poses: Poses) -> None:
        self._file.save(poses)
        self._poses = dict(poses.poses)
