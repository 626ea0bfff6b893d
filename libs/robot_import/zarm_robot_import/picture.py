"""A picture of an imported robot at home: its meshes, the exact geometry and the sphere cover."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from zarm_geometry.robot_model import RobotModel
from zarm_robot_import.fitting import Fitted
from zarm_robot_import.primitives import below, triangles_of
from zarm_robot_import.spheres import ball_rows
from zarm_robot_import.triangles import points_on
from zarm_trajectory.arrays import Array

_POINTS = 60_000
_VIEW = np.array([0.75, -0.6, 0.35])


def draw(
    path: Path, model: RobotModel, home: Sequence[float], meshes: Mapping[str, Array], fitted: Sequence[Fitted]
) -> None:
    """Write a PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    poses = dict(zip(model.links, model.link_transforms(home), strict=True))
    clouds = [
        ("meshes", [(link, *_of_mesh(triangles, _POINTS // 8)) for link, triangles in meshes.items()]),
        ("exact geometry", [(link.link, *_of_rows(link.rows)) for link in fitted]),
        ("sphere cover", [(link.link, *_of_rows(ball_rows(link.balls))) for link in fitted]),
    ]
    figure = Figure(figsize=(15, 6), dpi=100)
    FigureCanvasAgg(figure)
    back = _VIEW / np.linalg.norm(_VIEW)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    up = np.cross(back, right)
    light = np.array([0.3, -0.4, 0.85])
    for place, (title, parts) in enumerate(clouds):
        points = np.concatenate([p @ poses[link][:3, :3].T + poses[link][:3, 3] for link, p, _ in parts])
        normals = np.concatenate([n @ poses[link][:3, :3].T for link, _, n in parts])
        hue = np.concatenate([np.full(len(p), index) for index, (_, p, _) in enumerate(parts)])
        order = np.argsort(points @ back)
        shade = 0.35 + 0.65 * np.clip(np.abs(normals @ light), 0, 1)
        colours = _COLOURS[hue.astype(int) % len(_COLOURS)] * shade[:, None]
        axes = figure.add_subplot(1, 3, place + 1)
        axes.scatter(points[order] @ right, points[order] @ up, c=colours[order], s=3, linewidths=0)
        axes.set_aspect("equal")
        axes.set_title(title)
        axes.set_axis_off()
    figure.subplots_adjust(left=0.01, right=0.99, bottom=0.01, top=0.93, wspace=0.02)
    figure.savefig(path)


_COLOURS = np.array(
    [(0.55, 0.6, 0.68), (0.95, 0.6, 0.3), (0.4, 0.7, 0.95), (0.6, 0.8, 0.45), (0.9, 0.75, 0.3), (0.7, 0.6, 0.9)]
)


def _of_mesh(triangles: Array, count: int) -> tuple[Array, Array]:
    points, which = points_on(triangles, count)
    a, b, c = triangles[which].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    return points, normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


def _of_rows(rows: Array) -> tuple[Array, Array]:
    points, normals = [], []
    for i, row in enumerate(rows):
        on, normal = _of_mesh(triangles_of(row), _POINTS // 4 // len(rows))
        outer = ~below(on, np.delete(rows, i, axis=0))
        points.append(on[outer])
        normals.append(normal[outer])
    return np.concatenate(points), np.concatenate(normals)
