"""Seven worlds that look alike in many places, each with the ways through it.

A layout has surfaces, a network of ways whose nodes hold places of the sensor in m, and the sensor that fits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise, product

import networkx as nx
import numpy as np

from scenarios.worlds import sensors
from scenarios.worlds.sensors import Sensor
from scenarios.worlds.solid import Array, Solid, box, plate

CLUTTER_EVERY = 8.0
"""Way from one thing that stands beside it to the next, in sizes of such things."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Layout:
    """A world, its ways, and the manner of driving.

    Attributes
    ----------
    solid : Solid
    ways : networkx.Graph
        Nodes are places (x, y, z) of the sensor, m; edges are straight ways.
    sensor : Sensor
    step_m : float
        Way between keyframes.
    length_m : float
        Way driven.
    landmarks_per_m2 : float
        On all surfaces; a sensor takes the strongest points in view.
    """

    solid: Solid
    ways: nx.Graph
    sensor: Sensor
    step_m: float
    length_m: float
    landmarks_per_m2: float


def offices() -> Layout:
    """Corridors in a grid, 2 m wide, equal doors every 4 m."""
    pitch, half, height, n = 12.0, 1.0, 2.6, 4
    faces = [plate((-2, -2, 0), (n * pitch, 0, 0), (0, n * pitch, 0)), *_outer_walls(-half, 3 * pitch + half, height)]
    for a, b in product(range(n - 1), repeat=2):
        low, high = np.array([a, b]) * pitch + half, np.array([a + 1, b + 1]) * pitch - half
        faces.append(box((*(low + 0.4), 0), (*(high - 0.4), height)))
        for k in range(3):  # wall pieces between recessed doors
            start, end = 0.4 + 3.2 * k, 0.4 + 3.2 * k + 2.2
            faces += [
                box((low[0] + start, low[1], 0), (low[0] + end, low[1] + 0.4, height)),
                box((low[0] + start, high[1] - 0.4, 0), (low[0] + end, high[1], height)),
                box((low[0], low[1] + start, 0), (low[0] + 0.4, low[1] + end, height)),
                box((high[0] - 0.4, low[1] + start, 0), (high[0], low[1] + end, height)),
            ]
    ways = _grid(n, n, pitch, 0.5)
    faces.append(_clutter(ways, 0.5, (0.8, 0.9), (0.3, 0.3, 1.0)))
    return Layout(
        solid=Solid(np.concatenate(faces)),
        ways=ways,
        sensor=sensors.LIDAR_2D,
        step_m=1.0,
        length_m=360.0,
        landmarks_per_m2=6.0,
    )


def storeys() -> Layout:
    """Four equal floors, a corridor around each, stairs at one corner."""
    n_floors, rise, half, a, b = 4, 3.0, 1.0, 20.0, 12.0

    # floors with doors, and the way around each
    faces, ways = [], nx.Graph()
    for floor in range(n_floors):
        z = floor * rise
        faces.append(plate((-half, -half, z), (a + 2 * half, 0, 0), (0, b + 2 * half, 0)))
        faces.append(box((half, half, z), (a - half, b - half, z + rise)))
        faces += [box((x, -half - 0.3, z), (x + 2.8, -half, z + 2.4)) for x in np.arange(-half, a, 4.0)]
        faces += [box((x, b + half, z), (x + 2.8, b + half + 0.3, z + 2.4)) for x in np.arange(-half, a, 4.0)]
        faces += [box((-half - 0.3, y, z), (-half, y + 2.8, z + 2.4)) for y in np.arange(-half, b, 4.0)]
        faces += [box((a + half, y, z), (a + half + 0.3, y + 2.8, z + 2.4)) for y in np.arange(4.0, b, 4.0)]
        ring = [(0.0, 0.0), (a, 0.0), (a, b), (0.0, b), (0.0, 0.0)]
        _connect(ways, [(x, y, z + 1.2) for x, y in ring])
    for floor in range(n_floors - 1):  # a flight out to a landing and back, in a shaft beside the corridor
        z, landing, beside = floor * rise, a + 6.0, half + 0.6
        faces.append(plate((a + half, -half, z), (4, 0, rise / 2), (0, 2 * half, 0)))
        faces.append(plate((a + half + 4, -half, z + rise / 2), (2 * half, 0, 0), (0, 4 * half + 1.2, 0)))
        faces.append(plate((a + half, beside, z + rise), (4, 0, -rise / 2), (0, 2 * half, 0)))
        eye, out = 1.2, a + half
        _connect(
            ways,
            [
                (a, 0.0, z + eye),
                (out, 0.0, z + eye),
                (landing, 0.0, z + rise / 2 + eye),
                (landing, 2.6, z + rise / 2 + eye),
                (out, 2.6, z + rise + eye),
                (a, 2.6, z + rise + eye),
                (a, 0.0, z + rise + eye),
            ],
        )

    # clutter, roof and shaft
    faces.append(_clutter(ways, 1.2, (0.8, 0.9), (0.3, 0.3, 1.0)))
    top = n_floors * rise
    faces.append(plate((-half, -half, top), (a + 9, 0, 0), (0, b + 2 * half, 0)))
    shaft = a + 4 * half + 3.2
    faces.append(plate((shaft, -half, 0), (0, 5, 0), (0, 0, top)))
    faces += [plate((a + half, y, 0), (shaft - a - half, 0, 0), (0, 0, top)) for y in (-half, 4.0)]
    return Layout(
        solid=Solid(np.concatenate(faces)),
        ways=ways,
        sensor=sensors.CAMERA,
        step_m=1.0,
        length_m=420.0,
        landmarks_per_m2=30.0,
    )


def streets() -> Layout:
    """Equal blocks of equal houses on a square grid of streets."""
    pitch, half, n = 40.0, 6.0, 3
    faces = [plate((-40, -40, 0), (160, 0, 0), (0, 160, 0))]
    for a, b in product(range(-1, n), repeat=2):
        for u, v in product(range(3), repeat=2):
            if (u, v) != (1, 1):
                low = np.array([a, b]) * pitch + half + 10.0 * np.array([u, v])
                faces.append(box((*low, 0), (*(low + 8.0), 7.0 + 2.0 * ((u + v) % 2))))
    ways = _grid(n, n, pitch, 1.8)
    faces.append(_clutter(ways, 1.8, (4.0, 5.0), (1.8, 1.8, 1.6)))
    return Layout(
        solid=Solid(np.concatenate(faces)),
        ways=ways,
        sensor=sensors.LIDAR_3D,
        step_m=3.0,
        length_m=1000.0,
        landmarks_per_m2=0.5,
    )


def garage() -> Layout:
    """Four equal decks with pillars, joined by ramps along one side."""
    n_decks, rise, length, width = 4, 3.2, 48.0, 32.0

    # decks with pillars, and their lanes
    faces, ways = [], nx.Graph()
    for deck in range(n_decks):
        z = deck * rise
        faces.append(plate((0, 0, z), (length, 0, 0), (0, width, 0)))
        faces += [
            box((x, y, z), (x + 0.6, y + 0.6, z + rise))
            for x, y in product(np.arange(0, length + 1, 8.0), np.arange(0, width + 1, 8.0))
        ]
        faces += [box((x, 0, z), (x + 5.0, 0.2, z + 1.0)) for x in np.arange(1.5, length, 8.0)]
        eye = z + 1.6
        lanes = [(4.0, 4.0), (44.0, 4.0), (44.0, 28.0), (4.0, 28.0), (4.0, 4.0)]
        _connect(ways, [(x, y, eye) for x, y in lanes])
        _connect(ways, [(20.0, 4.0, eye), (20.0, 28.0, eye)], splitting=True)
    for deck in range(n_decks - 1):  # outside the decks, up along y
        z = deck * rise
        faces.append(plate((length, 2, z), (5, 0, 0), (0, 2, 0)))
        faces.append(plate((length, 4, z), (0, 24, rise), (5, 0, 0)))
        faces.append(plate((length, 28, z + rise), (5, 0, 0), (0, 3, 0)))
        faces.append(plate((length + 5, 4, z), (0, 24, rise), (0, 0, 1)))
        eye = z + 1.6
        _connect(ways, [(44.0, 4.0, eye), (50.5, 4.0, eye), (50.5, 28.0, eye + rise), (44.0, 28.0, eye + rise)])

    # clutter and roof
    faces.append(_clutter(ways, 1.6, (2.5, 3.0), (1.0, 1.0, 1.5)))
    faces.append(plate((0, 0, n_decks * rise), (length, 0, 0), (0, width, 0)))
    return Layout(
        solid=Solid(np.concatenate(faces)),
        ways=ways,
        sensor=sensors.LIDAR_3D,
        step_m=2.0,
        length_m=800.0,
        landmarks_per_m2=1.0,
    )


def warehouse() -> Layout:
    """Eight equal aisles between racks, a way across both ends and the middle."""
    n, pitch, length, gap = 8, 4.2, 30.0, 3.0
    side = (n - 1) * pitch

    # floor, racks and end walls
    faces = [plate((-3, -3, 0), (side + 6, 0, 0), (0, 2 * length + 15, 0))]
    for k in range(n + 1):
        x = (k - 0.5) * pitch
        for start in (gap / 2, length + 1.5 * gap):
            for y in np.arange(start, start + length - 1, 3.0):
                faces.append(box((x - 0.6, y, 0), (x + 0.6, y + 2.6, 5.0)))
    far = 2 * length + 2 * gap
    faces.append(plate((-pitch, -gap / 2, 0), (side + 2 * pitch, 0, 0), (0, 0, 6)))
    faces.append(plate((-pitch, far + gap / 2, 0), (side + 2 * pitch, 0, 0), (0, 0, 6)))

    # aisles and the three ways across
    places = [(k * pitch, y, 0.5) for y in (0.0, length + gap, far) for k in range(n)]
    ways = nx.Graph()
    for row in range(3):
        _connect(ways, places[row * n : (row + 1) * n])
    for k in range(n):
        _connect(ways, places[k::n])
    faces.append(_clutter(ways, 0.5, (1.0, 1.2), (0.4, 0.4, 1.0)))
    return Layout(
        solid=Solid(np.concatenate(faces)),
        ways=ways,
        sensor=sensors.LIDAR_2D,
        step_m=1.2,
        length_m=420.0,
        landmarks_per_m2=2.0,
    )


def campus() -> Layout:
    """Equal halls far apart on open ground."""
    pitch, n = 60.0, 3
    faces = [plate((-60, -60, 0), (240, 0, 0), (0, 240, 0))]
    for a, b in product(range(-1, n), repeat=2):
        x, y = a * pitch + 30.0, b * pitch + 30.0
        faces.append(box((x - 12, y - 9, 0), (x + 12, y + 9, 9)))
        faces.append(box((x + 14, y - 14, 0), (x + 17, y - 11, 5)))
    ways = _grid(n, n, pitch, 1.5)
    faces.append(_clutter(ways, 1.5, (4.0, 9.0), (1.2, 1.2, 2.5)))
    return Layout(
        solid=Solid(np.concatenate(faces)),
        ways=ways,
        sensor=sensors.CAMERA,
        step_m=2.0,
        length_m=1300.0,
        landmarks_per_m2=0.6,
    )


def tunnel() -> Layout:
    """Two tubes with equal niches, cross passages between them."""
    length, apart, half, height = 240.0, 24.0, 4.0, 6.0
    faces = []
    for y in (0.0, apart):
        faces.append(plate((-8, y - half, 0), (length + 16, 0, 0), (0, 2 * half, 0)))
        faces.append(plate((-8, y - half, height), (length + 16, 0, 0), (0, 2 * half, 0)))
    passages = np.arange(0.0, length + 1, 60.0)
    for y, way in ((-half, -1), (apart + half, 1)):  # outer walls with niches
        for x in np.arange(-8.0, length, 20.0):
            faces.append(plate((x, y, 0), (16, 0, 0), (0, 0, height)))
            faces.append(plate((x + 16, y + way * 1.5, 0), (4, 0, 0), (0, 0, height)))
            faces.append(plate((x + 16, y, 0), (0, way * 1.5, 0), (0, 0, height)))
            faces.append(plate((x + 20, y, 0), (0, way * 1.5, 0), (0, 0, height)))
    for start, end in pairwise(passages):
        faces.append(box((start + 3, half, 0), (end - 3, apart - half, height)))
    faces += [plate((x - 3, half, 0), (6, 0, 0), (0, apart - 2 * half, 0)) for x in passages]
    ways = nx.Graph()
    for y in (0.0, apart):
        _connect(ways, [(x, y, 1.8) for x in passages])
    for x in passages:
        _connect(ways, [(x, 0.0, 1.8), (x, apart, 1.8)])
    faces.append(_clutter(ways, 1.8, (3.0, 3.6), (0.8, 0.8, 1.6)))
    faces += [plate((x, -half, 0), (0, apart + 2 * half, 0), (0, 0, height)) for x in (-8.0, length + 8.0)]
    return Layout(
        solid=Solid(np.concatenate(faces)),
        ways=ways,
        sensor=sensors.LIDAR_3D,
        step_m=3.0,
        length_m=1100.0,
        landmarks_per_m2=0.7,
    )


LAYOUTS: dict[str, Callable[[], Layout]] = {
    made.__name__: made for made in (offices, storeys, streets, garage, warehouse, campus, tunnel)
}


def _clutter(ways: nx.Graph, eye: float, beside: tuple[float, float], size: tuple[float, float, float]) -> Array:
    """Boxes here and there beside the ways, so that no two places look entirely alike; none at a crossing."""
    random, boxes = np.random.default_rng(1), [np.empty((0, 3, 3))]
    for one, other in sorted(tuple(sorted(ends)) for ends in ways.edges):
        along = np.subtract(other, one)
        length = float(np.linalg.norm(along))
        left = np.array([-along[1], along[0], 0.0]) / length
        margin = beside[1] + max(size)
        for _ in range(round((length - 2 * margin) / CLUTTER_EVERY / max(size))):
            at = one + random.uniform(margin, length - margin) / length * along
            at = at + random.choice([-1, 1]) * random.uniform(*beside) * left
            half = np.array([size[0], size[1], 0.0]) / 2
            boxes.append(box(at - half - [0, 0, eye], at + half + [0, 0, size[2] - eye]))
    return np.concatenate(boxes)


def _grid(n_x: int, n_y: int, pitch: float, eye: float) -> nx.Graph:
    ways = nx.Graph()
    for a in range(n_x):
        _connect(ways, [(a * pitch, b * pitch, eye) for b in range(n_y)])
    for b in range(n_y):
        _connect(ways, [(a * pitch, b * pitch, eye) for a in range(n_x)])
    return ways


def _connect(ways: nx.Graph, places: list[tuple[float, float, float]], *, splitting: bool = False) -> None:
    """Add straight ways from place to place; a way is split where another starts or ends upon it."""
    if splitting:
        for place in places:
            for one, other in list(ways.edges):
                if _between(place, one, other):
                    ways.remove_edge(one, other)
                    ways.add_edges_from([(one, place), (place, other)])
    ways.add_edges_from(pairwise(places))


def _between(place: tuple[float, ...], one: tuple[float, ...], other: tuple[float, ...]) -> bool:
    direct = np.linalg.norm(np.subtract(one, other))
    detour = np.linalg.norm(np.subtract(place, one)) + np.linalg.norm(np.subtract(place, other))
    return bool(detour < direct + 1e-9)


def _outer_walls(low: float, high: float, height: float) -> Iterator[Array]:
    side = high - low
    for corner, along in (
        ((low, low), (side, 0)),
        ((low, low), (0, side)),
        ((high, low), (0, side)),
        ((low, high), (side, 0)),
    ):
        yield plate((*corner, 0), (*along, 0), (0, 0, height))
