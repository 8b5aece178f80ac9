"""The audit in space: an Open3D window and off-screen pictures; Open3D is imported when a function is called."""

from __future__ import annotations

import ctypes
import logging
import math
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from plotly.colors import hex_to_rgb, sequential

from pgti_gtsam import outputs
from pgti_gtsam.dense_map import HOW_TO_INSTALL, load_open3d
from pgti_gtsam.errors import InvalidOptionError, MissingDependencyError, OutputError
from pgti_gtsam.report.html import require_schema

_LOG = logging.getLogger(__name__)

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_BLUE, _RED, _BALL = (0.18, 0.44, 0.86), (0.84, 0.15, 0.24), (0.23, 0.56, 0.53)  # as on the page
_INK = 40  # grey of the bar
_BALL_OPACITY = 0.2
_WORST_PLACES = 5
"""Places whose minimum spheres are drawn: more hide the map behind them."""

_FIELD_OF_VIEW_DEG = 45.0
_OVERSAMPLING = 2
"""Pictures are rendered this many times larger and averaged down. Open3D's own smoothing changes the colours."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Map:
    """The drawn parts of a document.

    Attributes
    ----------
    positions : (n, 3) m, from their mean
    radii : (n,) m
    scores : (n,), may be infinite
    edges, inserted : (m, 2), (k, 2) int, those of some length
    worst : (w,) int, the keyframes of the worst places that have a sphere
    """

    positions: FloatArray
    radii: FloatArray
    scores: FloatArray
    edges: IntArray
    inserted: IntArray
    worst: IntArray

    @property
    def planar(self) -> bool:
        """Whether the map lies in a plane of constant z."""
        return not np.ptp(self.positions[:, 2])

    @property
    def size(self) -> float:
        """Diagonal of the box around the keyframes, in m; for a single place, of its sphere."""
        diagonal = float(np.linalg.norm(np.ptp(self.positions, axis=0)))
        return diagonal or 2.0 * float(self.radii.max()) or 1.0


def show(document: Mapping[str, Any]) -> None:
    """Open a window that shows the audited map, and return when it is closed.

    Parameters
    ----------
    document : Mapping
        The JSON document of an audit, schema version 2.

    Raises
    ------
    MissingDependencyError
        Open3D or a system library is missing, or there is no display.
    InvalidValueError
        The document has another schema.
    """
    # a document that can be drawn, and a display
    drawn = _read(document)
    open3d = load_open3d()
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise MissingDependencyError(
            "there is no display to open a window on: write a picture instead, with --png FILE"
        )

    # layers, seen from the camera
    eye, centre, up = _camera(drawn, aspect=1.6)
    layers = [*_solids(open3d, drawn)]
    if len(drawn.worst):
        glass = _material(open3d, "defaultLitTransparency", opacity=_BALL_OPACITY)
        layers.append(("minimum spheres", _worst_spheres(open3d, drawn), glass))
    open3d.visualization.draw(
        [dict(zip(("name", "geometry", "material"), layer, strict=True)) for layer in layers],
        title=f"pgti-gtsam: {document['input']['name']}",
        width=1600,
        height=1000,
        eye=eye,
        lookat=centre,
        up=up,
        field_of_view=_FIELD_OF_VIEW_DEG,
    )


def render_png(document: Mapping[str, Any], path: Path | str, width: int = 1600, height: int = 1000) -> None:
    """Draw the audited map into a PNG file, without a display.

    Keyframes are coloured by ζ as on the page (an infinite ζ as the largest finite ζ), edges of the pose graph are
    blue, collisions are red tubes, and the minimum spheres of the worst places are translucent. A planar map is
    seen from above, any other slanted.

    Parameters
    ----------
    document : Mapping
        The JSON document of an audit, schema version 2.
    path : Path or str
        The picture to write or overwrite.
    width, height : int
        Size of the picture in pixels.

    Raises
    ------
    InvalidOptionError
        The size is not positive, or the name does not end in ".png".
    MissingDependencyError
        Open3D or a system library is missing.
    OutputError
        The picture cannot be written.
    InvalidValueError
        The document has another schema.
    """
    if width < 1 or height < 1:
        raise InvalidOptionError(f"expected a positive width and height, got {width} x {height}")
    if Path(path).suffix.lower() != ".png":
        raise InvalidOptionError(f'expected a file name that ends in ".png", got {str(path)!r}')
    drawn = _read(document)
    open3d = load_open3d()
    _require_vulkan()
    with _engine_in_the_log():
        image = _rendered(open3d, drawn, width, height)
    with outputs.drawn(path) as part:
        if not open3d.io.write_image(str(part), open3d.geometry.Image(image)):
            raise OutputError(f"{path} cannot be written: Open3D made no picture")


def legend(document: Mapping[str, Any]) -> str:
    """What the colours of a picture mean, and how long its bar is."""
    drawn = _read(document)
    finite = drawn.scores[np.isfinite(drawn.scores)]
    return (
        f"keyframes: ζ from 0, dark, to {finite.max(initial=0.0):.3g}, yellow; blue: pose graph; red: collisions; "
        f"shaded: free spheres of the worst places. The bar is {_bar(drawn, 1.6)[0]:g} m long in the middle of the map."
    )


def _rendered(open3d: Any, drawn: _Map, width: int, height: int) -> NDArray[np.uint8]:
    renderer = open3d.visualization.rendering.OffscreenRenderer(_OVERSAMPLING * width, _OVERSAMPLING * height)
    renderer.scene.set_background([1.0, 1.0, 1.0, 1.0])
    renderer.scene.view.set_post_processing(False)
    renderer.scene.view.set_sample_count(1)
    for name, geometry, material in _solids(open3d, drawn, pixel=_OVERSAMPLING):
        renderer.scene.add_geometry(name, geometry, material)
    without = covered = _picture(renderer, drawn, width / height)
    if len(drawn.worst):
        renderer.scene.add_geometry("minimum spheres", _worst_spheres(open3d, drawn), _material(open3d, "defaultUnlit"))
        covered = _picture(renderer, drawn, width / height)
    # The second picture laid over the first: spheres that overlap then show as one space, not as ever darker layers.
    image = np.asarray(((1 - _BALL_OPACITY) * without + _BALL_OPACITY * covered).round(), dtype=np.uint8)

    # a bar in the lower left corner, as long as the legend says
    length, thickness, margin = round(_bar(drawn, width / height)[1] * height), max(height // 150, 1), height // 25
    image[-margin - thickness : -margin, margin : margin + length] = _INK
    return image


def _bar(drawn: _Map, aspect: float) -> tuple[float, float]:
    """Length of the bar in m, and in heights of the picture: 1, 2 or 5 times a power of ten, a fifth of its width."""
    eye, centre, _ = _camera(drawn, aspect)
    away = float(np.linalg.norm(np.subtract(eye, centre)))
    height_m = 2.0 * away * math.tan(math.radians(_FIELD_OF_VIEW_DEG) / 2)
    most = 0.2 * aspect * height_m
    ten = 10.0 ** math.floor(math.log10(most))
    length_m = max(step * ten for step in (1, 2, 5) if step * ten <= most)
    return length_m, length_m / height_m


@contextmanager
def _engine_in_the_log() -> Iterator[None]:
    """What Open3D's engine prints goes to the log: the engine writes past Python, to the process's own outputs."""
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    with tempfile.TemporaryFile() as said:
        kept = [os.dup(descriptor) for descriptor in (1, 2)]
        try:
            for descriptor in (1, 2):
                os.dup2(said.fileno(), descriptor)
            yield
        finally:
            for descriptor, copy in zip((1, 2), kept, strict=True):
                os.dup2(copy, descriptor)
                os.close(copy)
        said.seek(0)
        for line in said.read().decode("utf-8", "replace").splitlines():
            _LOG.debug("%s", line)


def _require_vulkan() -> None:
    """Raise MissingDependencyError where Open3D's renderer would end the process for want of a Vulkan driver.

    Asks the loader for an instance with an empty VkInstanceCreateInfo (eight words, the first its type, 1).
    """
    if not sys.platform.startswith("linux"):
        return
    create_info, instance = (ctypes.c_uint64 * 8)(1), ctypes.c_void_p()
    try:
        vulkan = ctypes.CDLL("libvulkan.so.1")
    except OSError as error:
        raise MissingDependencyError(f"the Vulkan library cannot be loaded ({error}): {HOW_TO_INSTALL}") from error
    if vulkan.vkCreateInstance(create_info, None, ctypes.byref(instance)) != 0:
        raise MissingDependencyError(f"no Vulkan driver is installed: {HOW_TO_INSTALL}")
    vulkan.vkDestroyInstance(instance, None)


def _read(document: Mapping[str, Any]) -> _Map:
    """Take the drawn parts out of a document."""
    require_schema(document)
    keyframes, edges = document["keyframes"], document["edges"]
    positions = np.asarray(keyframes["position"], dtype=np.float64).reshape(-1, 3)
    radii = np.asarray(keyframes["radius"], dtype=np.float64)
    worst = [i for place in document["places"][:_WORST_PLACES] for i in place["keyframes"]]
    return _Map(
        positions=positions - positions.mean(axis=0),  # Open3D draws in float32
        radii=radii,
        scores=np.array([math.inf if score == "infinite" else score for score in keyframes["score"]]),
        edges=_long_enough(edges["pose_graph"], positions),
        inserted=_long_enough(edges["collisions"], positions),
        worst=np.unique([i for i in worst if radii[i] > 0]).astype(np.int64),
    )


def _long_enough(edges: ArrayLike, positions: FloatArray) -> IntArray:
    """Return the edges (m, 2) with distinct ends: a shape without any size ends Open3D's renderer."""
    pairs = np.asarray(edges, dtype=np.int64).reshape(-1, 2)
    long_enough: IntArray = pairs[(positions[pairs[:, 0]] != positions[pairs[:, 1]]).any(axis=1)]
    return long_enough


def _levels(scores: FloatArray) -> FloatArray:
    """Return scores (n,) in units of the largest finite score, infinite scores as 1."""
    top = scores[np.isfinite(scores)].max(initial=0.0) or 1.0
    return np.clip(scores / top, 0.0, 1.0)


def _colors(levels: FloatArray) -> FloatArray:
    """Return the page's colour, Viridis, (n, 3) of levels (n,) in [0, 1]."""
    stops = np.array([hex_to_rgb(stop) for stop in sequential.Viridis]) / 255.0
    where = np.linspace(0.0, 1.0, len(stops))
    return np.stack([np.interp(levels, where, channel) for channel in stops.T], axis=1)


def _solids(open3d: Any, drawn: _Map, pixel: int = 1) -> Iterator[tuple[str, Any, Any]]:
    """Yield name, geometry and material of each opaque layer that is not empty; lines are 1.5 pixels wide."""
    dot, plain = _dot_radius(drawn), _material(open3d, "defaultUnlit")
    if len(drawn.edges):
        lines = _lines(open3d, drawn.positions, drawn.edges, _BLUE)
        yield "pose graph", lines, _material(open3d, "unlitLine", width=1.5 * pixel)
    if len(drawn.inserted):
        radius = max(0.55 * dot, 0.0016 * drawn.size)
        yield "collisions", _tubes(open3d, drawn.positions[drawn.inserted], radius, _RED), plain
    level = _levels(drawn.scores)
    yield "keyframes", _balls(open3d, drawn.positions, dot * (1 + level), _colors(level)), plain


def _worst_spheres(open3d: Any, drawn: _Map) -> Any:
    """Return the minimum spheres of the worst places as a mesh."""
    return _balls(open3d, drawn.positions[drawn.worst], drawn.radii[drawn.worst], np.tile(_BALL, (len(drawn.worst), 1)))


def _dot_radius(drawn: _Map) -> float:
    """Return the radius in m of a keyframe's dot at ζ = 0: less than half a step, but visible at any size of map."""
    steps = np.linalg.norm(np.diff(drawn.positions[drawn.edges], axis=1)[:, 0], axis=1)
    apart = 0.2 * float(np.median(steps)) if len(steps) else math.inf
    return float(np.clip(apart, 0.0012 * drawn.size, 0.004 * drawn.size))


def _balls(open3d: Any, centres: FloatArray, radii: FloatArray, colors: FloatArray) -> Any:
    """Return a mesh of a ball for each centre (n, 3), radius (n,) and colour (n, 3)."""
    ball = open3d.geometry.TriangleMesh.create_sphere(1.0, resolution=10)
    vertices = centres[:, None] + radii[:, None, None] * np.asarray(ball.vertices)
    return _mesh(open3d, vertices, np.asarray(ball.triangles), colors)


def _tubes(open3d: Any, ends: FloatArray, radius: float, color: Sequence[float]) -> Any:
    """Return a mesh of a six-sided tube for each pair of ends (n, 2, 3)."""
    along = _unit(ends[:, 1] - ends[:, 0])
    side = _unit(np.cross(along, np.eye(3)[np.abs(along).argmin(axis=1)]))
    angles = np.arange(6)[:, None] * math.pi / 3
    rim = radius * (np.cos(angles) * side[:, None] + np.sin(angles) * np.cross(along, side)[:, None])
    k, after = np.arange(6), (np.arange(6) + 1) % 6
    faces = np.concatenate([np.stack(f, axis=1) for f in ((k, after, k + 6), (after, after + 6, k + 6))])
    vertices = np.concatenate([ends[:, :1] + rim, ends[:, 1:] + rim], axis=1)
    return _mesh(open3d, vertices, faces, np.tile(color, (len(ends), 1)))


def _mesh(open3d: Any, vertices: FloatArray, faces: NDArray[np.integer], colors: FloatArray) -> Any:
    """Return a mesh of n copies of a shape: vertices (n, v, 3), the shape's faces (f, 3), colours (n, 3)."""
    n, v = vertices.shape[:2]
    triangles = (faces + v * np.arange(n)[:, None, None]).reshape(-1, 3)
    # Not the older open3d.geometry.TriangleMesh: it has no texture coordinates, but its shader samples a texture at
    # whatever stands there, which takes minutes on a processor.
    mesh = open3d.t.geometry.TriangleMesh(
        open3d.core.Tensor(vertices.reshape(-1, 3).astype(np.float32)), open3d.core.Tensor(triangles.astype(np.int32))
    )
    mesh.vertex.colors = open3d.core.Tensor(np.repeat(colors, v, axis=0).astype(np.float32))
    mesh.compute_vertex_normals()
    return mesh


def _lines(open3d: Any, positions: FloatArray, edges: IntArray, color: Sequence[float]) -> Any:
    """Return a line for each edge (m, 2) between positions (n, 3)."""
    points, pairs = open3d.utility.Vector3dVector(positions), open3d.utility.Vector2iVector(edges.astype(np.int32))
    lines = open3d.geometry.LineSet(points, pairs)
    lines.paint_uniform_color(color)
    return lines


def _unit(vectors: FloatArray) -> FloatArray:
    """Return vectors (n, 3) scaled to length 1; zero stays zero."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(lengths > 0, lengths, 1.0)


def _camera(drawn: _Map, aspect: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return eye, centre and up vector (3,) from which all keyframes are seen, as large as width / height allows."""
    to_eye, up = _viewpoint(drawn)
    right = _unit(np.cross(up, to_eye))
    axes = np.stack([right, np.cross(to_eye, right), to_eye])
    points = drawn.positions @ axes.T
    slope = 0.9 * math.tan(math.radians(_FIELD_OF_VIEW_DEG / 2))  # a tenth stays free at the border
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    distance = drawn.size
    for _ in range(8):  # what is near looks larger: the middle of the picture follows the distance
        offset = points - middle
        needed = offset[:, 2] + np.maximum(np.abs(offset[:, 0]) / aspect, np.abs(offset[:, 1])) / slope
        distance = max(float(needed.max()), 0.1 * drawn.size)
        seen = offset[:, :2] / (distance - offset[:, 2:])
        middle[:2] += distance * (seen.min(axis=0) + seen.max(axis=0)) / 2
    centre = middle @ axes
    return centre + distance * to_eye, centre, up


def _viewpoint(drawn: _Map) -> tuple[FloatArray, FloatArray]:
    """Return the direction to the eye and the up vector, as on the page.

    A planar map is seen from straight above. In space the z axis points up, unless the map is far flatter along y: then
    the poses are camera poses, whose y axis points down. The longer side lies across the picture.
    """
    if drawn.planar:
        return np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])
    x, y, z = np.ptp(drawn.positions, axis=0)
    if y < 0.5 * min(x, z):
        return _unit(np.array([0.3, -1.0, -0.8] if x > z else [0.8, -1.0, 0.3])), np.array([0.0, -1.0, 0.0])
    return _unit(np.array([0.3, -0.8, 1.0] if x > y else [0.8, -0.3, 1.0])), np.array([0.0, 0.0, 1.0])


def _picture(renderer: Any, drawn: _Map, aspect: float) -> FloatArray:
    """Return the renderer's picture (h, w, 3), each square of oversampled pixels averaged."""
    eye, centre, up = _camera(drawn, aspect)
    renderer.setup_camera(_FIELD_OF_VIEW_DEG, centre, eye, up)  # fits the clipping planes to what is there by now
    image = np.asarray(renderer.render_to_image())
    height, width = image.shape[0] // _OVERSAMPLING, image.shape[1] // _OVERSAMPLING
    return np.asarray(image.reshape(height, _OVERSAMPLING, width, _OVERSAMPLING, 3).mean(axis=(1, 3)))


def _material(open3d: Any, shader: str, *, width: float = 1.0, opacity: float = 1.0) -> Any:
    """Return an Open3D material; `width` is that of lines in pixels."""
    material = open3d.visualization.rendering.MaterialRecord()
    material.shader, material.line_width = shader, width
    material.base_color = [1.0, 1.0, 1.0, opacity]
    return material
