"""A picture of a plan: the arm at its start and its end, the way of the tip, and what is around, from above and from the side."""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence

import matplotlib as mpl
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from zarm_contract.messages import Cuboid, Cylinder, Plan, SceneObject, Sphere
from zarm_geometry.frames import matrix
from zarm_geometry.robot_model import RobotModel
from zarm_mcp.policy import Policy
from zarm_trajectory.arrays import Array
from zarm_trajectory.trajectory import TimedTrajectory

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

_VIEWS = (("from above", 0, 1), ("from the side", 0, 2), ("from the front", 1, 2))
_CORNERS = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_TURN = np.linspace(0.0, 2 * np.pi, 24)


def picture(model: RobotModel, plan: Plan, objects: Iterable[SceneObject], policy: Policy) -> bytes:
    """A PNG. Objects that are no boxes, cylinders or balls are left out; lengths are in m, in the frame of the base."""
    motion = TimedTrajectory.of(plan.trajectory, model.robot.descriptor.joints)
    ways = motion.positions(np.linspace(motion.begin, motion.duration, 60))
    tips = np.array([model.fk_tip(position)[:3, 3] for position in ways])
    figure, axes = plt.subplots(1, 3, figsize=(15, 5), layout="constrained")
    for axis, (title, first, second) in zip(axes, _VIEWS, strict=True):
        axis.set(title=title, xlabel="xyz"[first] + " (m)", ylabel="xyz"[second] + " (m)", aspect="equal")
        for item in objects:
            _fill(axis, _points(item)[:, (first, second)], "tab:brown", item.name)
        for item in policy.zones():
            _fill(axis, _points(item)[:, (first, second)], "tab:red", item.name)
        if policy.workspace is not None:
            lower, upper = (
                np.array(bound)[[first, second]] for bound in (policy.workspace.lower, policy.workspace.upper)
            )
            width, height = (upper - lower).tolist()
            axis.add_patch(
                Rectangle((lower[0], lower[1]), width, height, fill=False, edgecolor="tab:red", linestyle="--")
            )
        for position, colour, label in ((motion.start, "lightgrey", "start"), (motion.end, "tab:blue", "end")):
            _arm(axis, model, position, (first, second), colour, label)
        axis.plot(tips[:, first], tips[:, second], color="tab:green", label="tip")
    axes[0].legend(loc="upper right", fontsize="small")
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=70)
    plt.close(figure)
    return file.getvalue()


def _arm(axis: Axes, model: RobotModel, position: Array, view: Sequence[int], colour: str, label: str) -> None:
    frames = model.link_transforms(position)
    centres = frames[:, :3, 3][:, list(view)]
    axis.plot(centres[:, 0], centres[:, 1], color=colour, linewidth=8, solid_capstyle="round", label=label, alpha=0.8)


def _fill(axis: Axes, points: Array, colour: str, name: str) -> None:
    try:
        around = points[ConvexHull(points).vertices]
    except QhullError:
        return
    axis.fill(around[:, 0], around[:, 1], color=colour, alpha=0.3)
    axis.annotate(name, around.mean(axis=0), fontsize="x-small", ha="center")


def _points(item: SceneObject) -> Array:
    """Points (N, 3) whose hull is the object."""
    pose = matrix(item.position, getattr(item, "orientation", (0.0, 0.0, 0.0, 1.0)))
    if isinstance(item, Cuboid):
        local = _CORNERS * item.size
    elif isinstance(item, Sphere):
        local = item.radius * np.array(
            [
                (0.7 * np.cos(a) * s, 0.7 * np.sin(a) * s, z)
                for a in _TURN
                for s, z in ((0, 1), (0, -1), (1.42, 0), (1, 0.7), (1, -0.7))
            ]
        )
    elif isinstance(item, Cylinder):
        local = np.array(
            [(item.radius * np.cos(a), item.radius * np.sin(a), z * item.length) for a in _TURN for z in (-0.5, 0.5)]
        )
    else:
        return np.array(pose[:3, 3])[None]
    return np.asarray(local @ pose[:3, :3].T + pose[:3, 3])
