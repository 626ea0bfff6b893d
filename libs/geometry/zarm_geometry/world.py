"""The obstacles of one scene, packed for the collision kernels."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import NamedTuple, Self

import numpy as np

from zarm_contract.messages import Mesh, Primitive, SceneObject, Voxels
from zarm_geometry import packed_shapes
from zarm_geometry.allowed_collisions import Pairs, checked
from zarm_geometry.box_tree import BoxTree, joined
from zarm_geometry.frames import matrix
from zarm_geometry.meshes import Meshes
from zarm_geometry.voxels import cells_of, edges, merged
from zarm_trajectory.arrays import Array


class World:
    """Scene objects in the base frame, with `margin` (m) around them in `arrays`. Immutable.

    `rows` (n, 17) are the convex shapes of the objects, in the order of the tree and without the margin, see
    `zarm_geometry.packed_shapes`; `owner` (n,) is the index in `names` of the object to which each belongs. Prepared meshes and
    voxels are reused from `before`, an earlier world; one that only moved is only placed again. Raises Unavailable for
    a mesh that is not in `meshes`.
    """

    def __init__(
        self,
        objects: Sequence[SceneObject],
        margin: float,
        meshes: Meshes | None = None,
        before: World | None = None,
    ) -> None:
        known = before._made if before else {}
        self._made: dict[str, _Made] = {}
        single: list[Primitive] = []
        owners: list[int] = []
        for index, item in enumerate(objects):
            if isinstance(item, Mesh | Voxels):
                self._made[item.name] = _made(item, meshes or Meshes(), known.get(item.name))
            else:
                single.append(item)
                owners.append(index)
        trees = [made.placed for made in self._made.values()]
        singles = BoxTree.over(packed_shapes.primitives(single))
        place = {item.name: index for index, item in enumerate(objects)}
        places, counts = [place[name] for name in self._made], [len(tree.rows) for tree in trees]
        self.names = tuple(item.name for item in objects)
        self.margin = margin
        self.allowed: Pairs = ()
        self.rows = np.concatenate([*(tree.rows for tree in trees), singles.rows])
        self.owner = np.concatenate(
            [np.repeat(np.array(places, np.intp), counts), np.array(owners, np.intp)[singles.order]]
        )
        self.arrays = joined([*trees, singles], margin)

    def with_allowed(self, pairs: Pairs) -> Self:
        """The same objects, which links may touch by these pairs: for a robot that knows the same ones."""
        if pairs == self.allowed:
            return self
        other = copy(self)
        other.allowed, other.arrays = pairs, self.arrays._replace(checked=checked(self.names, pairs)[self.owner])
        return other

    def with_margin(self, margin: float) -> Self:
        """The same objects with another margin (m), at no cost."""
        if margin == self.margin:
            return self
        other = copy(self)
        other.margin, other.arrays = margin, self.arrays._replace(margin=margin)
        return other


class _Made(NamedTuple):
    """The prepared form of an object: the tree over its shapes in its own frame, and the placed one."""

    item: Mesh | Voxels
    tree: BoxTree
    placed: BoxTree


def _made(item: Mesh | Voxels, meshes: Meshes, before: _Made | None) -> _Made:
    """The placed tree of a mesh or of voxels; `before`, known under its name, may be of a different one."""
    if before is not None and before.item is item:
        return before
    if isinstance(item, Mesh):
        tree = meshes.tree(item)
    elif before is not None and isinstance(before.item, Voxels) and _same_cells(before.item, item):
        tree = before.tree
    else:
        tree = BoxTree.over(_boxes(item))
    return _Made(item, tree, tree.placed(matrix(item.position, item.orientation)))


def _same_cells(one: Voxels, other: Voxels) -> bool:
    return one.cells is other.cells and one.resolution == other.resolution


def convex_shapes(item: SceneObject, meshes: Meshes) -> Array:
    """The shapes (n, 17) of an object, in the base frame."""
    if not isinstance(item, Mesh | Voxels):
        return packed_shapes.primitives([item])
    own = meshes.tree(item).rows if isinstance(item, Mesh) else _boxes(item)
    return packed_shapes.placed(own, matrix(item.position, item.orientation))


def _boxes(item: Voxels) -> Array:
    """The shapes (n, 17) of voxels, in their own frame."""
    return packed_shapes.boxes(*edges(*merged(cells_of(item)), item.resolution))
