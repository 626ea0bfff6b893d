"""The obstacles of one scene, packed once for the collision kernels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from zarm_contract.messages import Mesh, Primitive, SceneObject, Voxels
from zarm_geometry import rows
from zarm_geometry.box_tree import BoxTree
from zarm_geometry.frames import matrix
from zarm_geometry.meshes import Meshes
from zarm_geometry.voxels import cells_of, edges, merged

Array = NDArray[np.float64]


class World:
    """Scene objects in the base frame, with `margin` (m) added all around in `arrays`. Immutable.

    `rows` (n, 17) are the convex shapes that the objects consist of, in the order of the tree and without the margin, see
    `zarm_geometry.rows`; `owner` (n,) is the index in `names` of the object that each is part of. What `before`, an earlier world,
    has made ready of the same meshes and voxels is taken from there. Raises Unavailable for a mesh that is not in `meshes`.
    """

    def __init__(
        self,
        objects: Sequence[SceneObject],
        margin: float,
        meshes: Meshes | None = None,
        before: World | None = None,
    ) -> None:
        known = before._trees if before else {}
        self._trees: dict[str, tuple[Mesh | Voxels, BoxTree]] = {}
        single: list[Primitive] = []
        owners: list[int] = []
        for index, item in enumerate(objects):
            if isinstance(item, Mesh | Voxels):
                kept = known.get(item.name)
                if kept is None or kept[0] is not item:
                    kept = item, BoxTree.over(convex_shapes(item, meshes or Meshes()))
                self._trees[item.name] = kept
            else:
                single.append(item)
                owners.append(index)
        place = {item.name: index for index, item in enumerate(objects)}
        trees = [BoxTree.over(rows.primitives(single)), *(tree for _, tree in self._trees.values())]
        of_trees = [np.full(len(tree.rows), place[name]) for name, (_, tree) in self._trees.items()]
        tree = BoxTree.joined(trees)
        self.names = tuple(item.name for item in objects)
        self.margin = margin
        self.rows, self.owner = tree.rows, np.concatenate([np.array(owners, np.intp), *of_trees])[tree.order]
        self.arrays = tree.arrays(margin)


def convex_shapes(item: SceneObject, meshes: Meshes) -> Array:
    """The shapes (n, 17) that an object consists of, in the base frame."""
    if not isinstance(item, Mesh | Voxels):
        return rows.primitives([item])
    own = meshes.rows(item) if isinstance(item, Mesh) else _boxes(item)
    return rows.placed(own, matrix(item.position, item.orientation))


def _boxes(item: Voxels) -> Array:
    """The shapes (n, 17) of voxels, in their own frame."""
    return rows.boxes(*edges(*merged(cells_of(item)), item.resolution))
