"""`zarm-to-lerobot`: records of zarm as a data set of LeRobot."""

from __future__ import annotations

import itertools
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from lerobot.datasets.lerobot_dataset import LeRobotDataset

import zarm
from lerobot_robot_zarm.episode import Episode, Frame


def convert(
    records: Sequence[Path], repo_id: str, task: str, *, fps: int = 30, root: Path | None = None
) -> LeRobotDataset:
    """The records as the episodes of a new data set in the folder `root` (default: LeRobot's), with `fps` frames a second.

    The observation is what `Zarm` observes; the action of a frame is the position in the next one, as with `ZarmTeleop`. Raises zarm.InvalidRequest for a file
    that is no record, records of different robots or cameras, and a folder that is there already; then nothing is left of the data set.
    """
    episodes = [Episode(record, fps) for record in records]
    features = _features(episodes[0].first)
    for episode in episodes[1:]:
        if _features(episode.first) != features:
            raise zarm.InvalidRequest(
                f"{episode.file} has other joints, grippers, cameras, or sizes of images than {episodes[0].file}; make a data set of each",
                field="records",
            )
    try:
        dataset = LeRobotDataset.create(repo_id, fps, features, root=root, robot_type="zarm")
    except FileExistsError as error:
        raise zarm.InvalidRequest(f"{error.filename} is there already; name another folder", field="root") from error
    try:
        for episode in episodes:
            for frame, following in itertools.pairwise(episode.frames()):
                dataset.add_frame({**_values(frame, following), "task": task})
            dataset.save_episode()
        dataset.finalize()
    except BaseException:
        shutil.rmtree(dataset.root)
        raise
    return dataset


def command(
    records: Annotated[
        list[Path], typer.Argument(help="The records (`zarm record --images`), each of which becomes an episode.")
    ],
    repo_id: Annotated[str, typer.Option(help="The data set, as `me/pick`.")],
    task: Annotated[str, typer.Option(help="The task, in words.")],
    fps: Annotated[int, typer.Option(min=1, max=200, help="Frames a second.")] = 30,
    root: Annotated[Path | None, typer.Option(help="The folder of the data set (default: LeRobot's).")] = None,
    push: Annotated[bool, typer.Option("--push", help="Push it to the hub.")] = False,
) -> None:
    """Make a data set of LeRobot from records of zarm."""
    try:
        dataset = convert(records, repo_id, task, fps=fps, root=root)
    except zarm.Error as error:
        raise typer.BadParameter(str(error)) from error
    typer.echo(f"{dataset.meta.total_episodes} episodes, {dataset.meta.total_frames} frames in {dataset.root}")
    if push:
        dataset.push_to_hub()


def main() -> None:
    """Run the command."""
    typer.run(command)


def _features(frame: Frame) -> dict[str, dict[str, Any]]:
    names = [f"{part}.pos" for part in frame.positions]
    positions = {"dtype": "float32", "shape": (len(names),), "names": names}
    images = {
        f"observation.images.{camera}": {
            "dtype": "video",
            "shape": image.shape,
            "names": ["height", "width", "channels"],
        }
        for camera, image in frame.images.items()
    }
    return {"action": positions, "observation.state": positions, **images}


def _values(frame: Frame, following: Frame) -> dict[str, Any]:
    images = {f"observation.images.{camera}": image for camera, image in frame.images.items()}
    return {
        "observation.state": np.array(list(frame.positions.values()), np.float32),
        "action": np.array(list(following.positions.values()), np.float32),
        **images,
    }
