"""COLLADA 1.4 and 1.5: the geometry that the scene places, in metres.

Its unit applies to everything, and its up axis is not applied: so does RViz, for which robots' files are made
(`mesh_loader.cpp` takes the unit and leaves out the root's transform).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np

from zarm_geometry.mesh_files.mesh_file import MeshFile, Unreadable, accounted, many
from zarm_geometry.mesh_files.polygons import fan, strip, triangulated, with_holes
from zarm_trajectory.arrays import Array, Indices

MOST_INSTANCES = 100_000
"""Most nodes and geometries that a scene may place: nodes placed again and again would grow without end."""
_PRIMITIVES = ("triangles", "polylist", "polygons", "tristrips", "trifans")
_THIN = ("lines", "linestrips")
_TRANSFORMS = ("matrix", "translate", "rotate", "scale", "lookat", "skew")
_INSTANCES = ("instance_geometry", "instance_node", "instance_controller")
_IN_MESH = ("source", "vertices", "extra", "asset")
_IN_NODE = ("asset", "extra", "instance_camera", "instance_light")
"""What has no geometry."""


def read(content: bytes) -> MeshFile:
    """The triangles that the file's scene places. Raises Unreadable."""
    document = _parsed(content)
    unit = _unit(document)
    scene = _scene(document)
    taken: set[Element] = set()
    shapes: dict[Element, Array] = {}
    found = [np.empty((0, 3, 3))]
    for instance, geometry, pose in _placed(document, scene, taken):
        taken.add(geometry)
        if geometry not in shapes:
            shapes[geometry] = _shape(document, geometry)
        triangles = shapes[geometry] @ pose[:3, :3].T + pose[:3, 3]
        if np.linalg.det(pose[:3, :3]) < 0.0:
            triangles = triangles[:, ::-1]  # mirrored: keep the orientation outwards
        taken.add(instance)
        found.append(triangles)
    document.notes += _left(document, taken)
    triangles = np.concatenate(found)
    if not len(triangles):
        raise Unreadable("its scene places no triangles; export it again")
    return MeshFile(triangles * unit, tuple(dict.fromkeys(document.notes)))


@dataclass
class _Document:
    root: Element
    lines: dict[Element, int]
    names: dict[str, Element]
    notes: list[str] = field(default_factory=list)

    def fault(self, element: Element, what: str) -> Unreadable:
        return Unreadable(f"line {self.lines[element]}: <{element.tag}>: {what}; correct it, or export it again")

    def named(self, element: Element, key: str) -> Element:
        """What an element's URL in the attribute `key` names."""
        url = element.get(key, "")
        if not url.startswith("#"):
            raise self.fault(element, f"{key}={url!r} names another file, which is not read; export it as one file")
        if url[1:] not in self.names:
            raise self.fault(element, f"there is nothing with the id {url[1:]!r}")
        return self.names[url[1:]]

    def numbers(self, element: Element, count: int | None = None) -> Array:
        """The numbers that an element holds."""
        try:
            values = np.array(list(map(float, (element.text or "").split())))
        except ValueError:
            raise self.fault(element, "not all of its values are numbers") from None
        if count is not None and len(values) != count:
            raise self.fault(element, f"it holds {len(values)} numbers, and should hold {count}")
        return values

    def indices(self, element: Element) -> Indices:
        """The whole numbers that an element holds."""
        try:
            return np.array(list(map(int, (element.text or "").split())), np.int64)
        except (ValueError, OverflowError):
            raise self.fault(element, "not all of its values are whole numbers") from None

    def whole(self, element: Element, key: str, default: int | None = None) -> int:
        """An attribute that is a whole number from 0."""
        value = element.get(key, "" if default is None else str(default))
        if not value.strip().isdecimal():
            raise self.fault(element, f"{key}={value!r} is no whole number")
        return int(value)


def _parsed(content: bytes) -> _Document:
    lines: dict[Element, int] = {}
    builder = TreeBuilder()
    parser = expat.ParserCreate(namespace_separator=" ")
    spaces: list[str] = []

    def start(tag: str, attributes: dict[str, str]) -> None:
        space, _, name = tag.rpartition(" ")
        spaces.append(space) if not spaces else None
        # An element of another vocabulary keeps its namespace, so that it is not taken for one of COLLADA.
        lines[builder.start(name if space == spaces[0] else f"{{{space}}}{name}", attributes)] = (
            parser.CurrentLineNumber
        )

    def end(_: str) -> None:
        builder.end("")

    def entity(*_: object) -> None:
        raise Unreadable("it declares an entity, which no exporter does; export it again")

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler, parser.EntityDeclHandler = builder.data, entity
    parser.buffer_text = True
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        text = expat.ErrorString(error.code)
        raise Unreadable(f"line {error.lineno}: not well-formed XML: {text}; export it again") from error
    except (LookupError, ValueError) as error:  # of an encoding that Python does not know
        raise Unreadable(f"{error}; save it as UTF-8") from error
    root = builder.close()
    if root.tag != "COLLADA":
        raise Unreadable(f"it starts with <{root.tag}>, not <COLLADA>; export it again")
    return _Document(root, lines, {name: element for element in root.iter() if (name := element.get("id"))})


def _unit(document: _Document) -> float:
    """Metres per unit. The axis that the file says is up is noted if it is another than z."""
    asset = document.root.find("asset")
    axis = (asset.findtext("up_axis") or "").strip() if asset is not None else ""
    if axis not in ("", "Z_UP"):
        document.notes.append(f"it says {axis}; its coordinates are taken as they are, as RViz does")
    units = {element.get("meter", "1") for element in document.root.iter("unit")}
    if len(units) > 1:
        raise Unreadable(f"it states several units, {' and '.join(sorted(units))} m; export it with one")
    try:
        unit = float(units.pop()) if units else 1.0
    except ValueError:
        unit = 0.0
    if not (math.isfinite(unit) and unit > 0.0):
        raise Unreadable("its <unit> has no meter= that is a positive number; export it again")
    return unit


def _scene(document: _Document) -> Element:
    chosen = document.root.find("scene/instance_visual_scene")
    if chosen is not None:
        scene = document.named(chosen, "url")
    else:
        scenes = document.root.findall("library_visual_scenes/visual_scene")
        if len(scenes) != 1:
            raise Unreadable("it does not say which of its scenes to show; write <scene>, or export it again")
        scene = scenes[0]
    if scene.tag != "visual_scene":
        raise document.fault(scene, "it is shown as a scene, and is none")
    return scene


def _placed(document: _Document, scene: Element, taken: set[Element]) -> Iterator[tuple[Element, Element, Array]]:
    """Each geometry that a scene places: its instance, the geometry, and the pose (4, 4)."""
    waiting: list[tuple[Element, Array, tuple[Element, ...]]] = [(scene, np.eye(4), ())]
    count = 0
    while waiting:
        node, pose, above = waiting.pop()
        if node in above:
            raise document.fault(node, "it is placed within itself")
        if (count := count + 1) > MOST_INSTANCES:
            raise Unreadable(f"its scene places more than {MOST_INSTANCES} nodes; simplify it")
        inner = [*above, node]
        pose = pose @ _pose(document, node)
        for child in node:
            match child.tag:
                case "node":
                    waiting.append((child, pose, tuple(inner)))
                case "instance_node":
                    taken.add(child)
                    waiting.append((document.named(child, "url"), pose, tuple(inner)))
                case "instance_geometry":
                    count += 1
                    yield child, document.named(child, "url"), pose
                case "instance_controller":
                    geometry, bind = _skin(document, document.named(child, "url"))
                    yield child, geometry, pose @ bind
                case tag if tag not in (*_TRANSFORMS, *_IN_NODE, "evaluate_scene"):
                    document.notes.append(f"line {document.lines[child]}: <{tag}> has no meaning for geometry")


def _skin(document: _Document, controller: Element) -> tuple[Element, Array]:
    """The mesh of a controller, and the pose in which its skeleton was bound to it."""
    skin, morph = controller.find("skin"), controller.find("morph")
    body = skin if skin is not None else morph
    if body is None:
        raise document.fault(controller, "it is neither a skin nor a morph")
    document.notes.append(
        f"line {document.lines[body]}: its <{body.tag}> is taken in the shape that it has without a skeleton"
    )
    bind = body.find("bind_shape_matrix")
    geometry = document.named(body, "source")
    pose = np.eye(4) if bind is None else document.numbers(bind, 16).reshape(4, 4)
    if geometry.tag == "controller":
        geometry, inner = _skin(document, geometry)
        pose = pose @ inner
    return geometry, pose


def _pose(document: _Document, node: Element) -> Array:
    """The product of a node's transforms, in their order."""
    pose = np.eye(4)
    for child in node:
        step = np.eye(4)
        match child.tag:
            case "matrix":
                step = document.numbers(child, 16).reshape(4, 4)
            case "translate":
                step[:3, 3] = document.numbers(child, 3)
            case "scale":
                step[:3, :3] = np.diag(document.numbers(child, 3))
            case "rotate":
                *axis, angle = document.numbers(child, 4).tolist()
                step[:3, :3] = _rotation(np.array(axis), math.radians(angle))
            case "lookat":
                step = _looking(document, child)
            case "skew":
                angle, *vectors = document.numbers(child, 7).tolist()
                step[:3, :3] = _skewed(math.radians(angle), np.array(vectors[:3]), np.array(vectors[3:]))
            case _:
                continue
        if child.tag == "matrix" and not np.array_equal(step[3], (0.0, 0.0, 0.0, 1.0)):
            raise document.fault(child, "its last row is not 0 0 0 1")
        pose = pose @ step
    return pose


def _rotation(axis: Array, angle: float) -> Array:
    """Rodrigues' formula."""
    length = float(np.linalg.norm(axis))
    if not length:
        return np.eye(3)
    x, y, z = axis / length
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross)


def _looking(document: _Document, element: Element) -> Array:
    """At the first point, with the negative z axis towards the second; the third vector is up."""
    eye, target, up = document.numbers(element, 9).reshape(3, 3)
    back = eye - target
    right = np.cross(up, back)
    if not np.linalg.norm(right):
        raise document.fault(element, "it looks nowhere, or upwards")
    back, right = back / np.linalg.norm(back), right / np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :4] = np.column_stack([right, np.cross(back, right), back, eye])
    return pose


def _skewed(angle: float, turned: Array, along: Array) -> Array:
    """RenderMan's skew: `turned` is turned by `angle` towards `along`, and `along` stays."""
    along = along / max(float(np.linalg.norm(along)), 1e-300)
    turned = turned / max(float(np.linalg.norm(turned)), 1e-300)
    across = turned - (turned @ along) * along
    height = float(np.linalg.norm(across))
    if not height:
        return np.eye(3)
    start = math.atan2(height, float(turned @ along))
    shift = 1.0 / math.tan(start - angle) - 1.0 / math.tan(start)
    return np.eye(3) + shift * np.outer(along, across / height)


def _shape(document: _Document, geometry: Element) -> Array:
    """The triangles (n, 3, 3) of a geometry in its own frame."""
    mesh = geometry.find("mesh")
    if mesh is None:
        kinds = [child.tag for child in geometry if child.tag not in ("asset", "extra")]
        if kinds == ["spline"]:
            document.notes.append(f"line {document.lines[geometry]}: a curve, which no arm touches, is not taken")
            return np.empty((0, 3, 3))
        raise document.fault(geometry, f"it is no mesh but {' '.join(kinds) or 'empty'}; export it as triangles")
    found, held = [np.empty((0, 3, 3))], 0
    for child in mesh:
        if child.tag in _PRIMITIVES:
            triangles = _primitive(document, mesh, child)
            held += _held(document, child)
            found.append(triangles)
        elif child.tag in _THIN:
            count = document.whole(child, "count", 0)
            document.notes.append(
                f"line {document.lines[child]}: {many(count, 'line')}, which no arm touches, are not taken"
            )
        elif child.tag not in _IN_MESH:
            document.notes.append(f"line {document.lines[child]}: <{child.tag}> in <mesh> is not known and not taken")
    shape = np.concatenate(found)
    accounted(f"triangles of the geometry {geometry.get('id') or geometry.get('name')}", held, len(shape))
    return shape


def _inputs(document: _Document, element: Element) -> tuple[int, int, Element]:
    """How many indices each corner has, which of them is the vertex, and the <vertices>."""
    inputs = element.findall("input")
    vertex = [one for one in inputs if one.get("semantic") == "VERTEX"]
    if len(vertex) != 1:
        raise document.fault(element, "it has no <input> with the semantic VERTEX")
    stride = 1 + max(document.whole(one, "offset", 0) for one in inputs)
    return stride, document.whole(vertex[0], "offset", 0), document.named(vertex[0], "source")


def _held(document: _Document, element: Element) -> int:
    """How many triangles a primitive has, by its numbers of corners in the text alone."""
    stride, _, _ = _inputs(document, element)
    corners = [len((one.text or "").split()) // stride for one in element.iter("p")]
    holes = [len((one.text or "").split()) // stride for one in element.iter("h")]
    match element.tag:
        case "triangles":
            return sum(corners) // 3
        case "polylist":
            counts = [int(word) for one in element.findall("vcount") for word in (one.text or "").split()]
            return sum(max(0, count - 2) for count in counts)
        case _:
            return sum(max(0, count - 2) for count in corners) + sum(count + 2 for count in holes)


def _primitive(document: _Document, mesh: Element, element: Element) -> Array:
    stride, offset, vertices = _inputs(document, element)
    points = _positions(document, vertices)

    def corners(one: Element) -> Indices:
        values = document.indices(one)
        if len(values) % stride:
            raise document.fault(one, f"its {len(values)} indices are no multiple of {stride}, the number of inputs")
        chosen = values[offset::stride]
        if len(chosen) and (chosen.min() < 0 or chosen.max() >= len(points)):
            wrong = int(chosen[(chosen < 0) | (chosen >= len(points))][0])
            raise document.fault(one, f"it names the vertex {wrong}, and there are {len(points)}, counted from 0")
        return chosen

    parts = [corners(one) for one in element.findall("p")]
    count = document.whole(element, "count", len(parts))
    match element.tag:
        case "triangles":
            every = np.concatenate([np.empty(0, np.int64), *parts])
            if len(every) != 3 * count:
                raise document.fault(element, f"it announces {many(count, 'triangle')} and has {len(every)} corners")
            found = every.reshape(-1, 3)
        case "polylist":
            every = np.concatenate([np.empty(0, np.int64), *parts])
            sizes = np.concatenate([np.empty(0, np.int64), *map(document.indices, element.findall("vcount"))])
            if len(sizes) != count or sizes.sum() != len(every) or (sizes < 0).any():
                raise document.fault(
                    element,
                    f"it announces {many(count, 'polygon')}, lists {len(sizes)} with {sizes.sum()} corners, and has {len(every)}",
                )
            found = triangulated(points, sizes, every)
            if thin := int((sizes < 3).sum()):
                document.notes.append(
                    f"line {document.lines[element]}: {many(thin, 'polygon')} of fewer than 3 corners have no area and are not taken"
                )
        case "polygons":
            holed = [
                with_holes(points, corners(outline), [corners(hole) for hole in one.findall("h")])
                for one in element.findall("ph")
                if (outline := one.find("p")) is not None
            ]
            if len(parts) + len(holed) != count:
                raise document.fault(
                    element, f"it announces {many(count, 'polygon')} and has {len(parts) + len(holed)}"
                )
            sizes = np.array([len(part) for part in parts], np.int64)
            every = np.concatenate([np.empty(0, np.int64), *parts])
            found = np.concatenate([triangulated(points, sizes, every), *holed])
        case tag:
            if len(parts) != count:
                raise document.fault(element, f"it announces {count} and has {len(parts)}")
            cut = strip if tag == "tristrips" else fan
            found = np.concatenate([np.empty((0, 3), np.int64), *(cut(part) for part in parts if len(part) > 2)])
    return np.asarray(points[found])


def _positions(document: _Document, vertices: Element) -> Array:
    """The places (n, 3) of vertices."""
    for one in vertices.findall("input"):
        if one.get("semantic") == "POSITION":
            break
    else:
        raise document.fault(vertices, "it has no <input> with the semantic POSITION")
    source = document.named(one, "source")
    accessor = source.find("technique_common/accessor")
    if accessor is None:
        raise document.fault(source, "it has no <accessor>")
    array = document.named(accessor, "source")
    values = document.numbers(array, document.whole(array, "count"))
    count, stride = document.whole(accessor, "count"), document.whole(accessor, "stride", 1)
    offset = document.whole(accessor, "offset", 0)
    params = accessor.findall("param")
    # A parameter without a name is skipped, by the specification.
    columns = [at for at, param in enumerate(params) if param.get("name")] if params else [0, 1, 2]
    if len(columns) < 3 or stride < columns[2] + 1:
        raise document.fault(accessor, "its positions have fewer than three coordinates")
    if offset + stride * count > len(values):
        raise document.fault(accessor, f"it takes {offset + stride * count} numbers, and there are {len(values)}")
    return values[offset : offset + stride * count].reshape(count, stride)[:, columns[:3]]


def _left(document: _Document, taken: set[Element]) -> Iterator[str]:
    """What the file holds and the scene does not."""
    instances = [element for element in document.root.iter() if element.tag in _INSTANCES]
    if lost := [element for element in instances if element not in taken]:
        lines = ", ".join(str(document.lines[element]) for element in lost[:5])
        yield f"{many(len(lost), 'instance')} in parts that its scene does not place, in line {lines}, are not taken"
    geometries = [element for element in document.root.iter("geometry") if element not in taken]
    if unplaced := [element for element in geometries if element.find("mesh") is not None]:
        names = ", ".join(element.get("name") or element.get("id") or "?" for element in unplaced[:5])
        yield f"{many(len(unplaced), 'geometry', 'geometries')} that its scene does not place are not taken: {names}"
