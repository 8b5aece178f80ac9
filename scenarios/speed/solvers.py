"""The heat kernels of pose graph and merged graph by each solver in turn, in the same process."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pygsp import filters, graphs
from scipy import sparse
from scipy.sparse.linalg import eigsh

import pgti_gtsam as pgti
from pgti_gtsam import datasets
from pgti_gtsam.estimate import optimised
from pgti_gtsam.integrity import STABLE_TIMES, relative_distortion, time_grid
from pgti_gtsam.spectral.heat_kernel import heat_kernels
from pgti_gtsam.spectral.laplacian import adjacency, laplacian
from pgti_gtsam.support_graph import support_graph

Edges = NDArray[np.int64]
Row = dict[str, Any]

REAL = {
    "kitti_00": ("kitti_robustslam/00/kitti_00_odom_GT_LC.g2o", 4.0),
    "MIT": ("pose_graphs/MIT.g2o", 1.0),
    "sphere2500": ("pose_graphs/sphere2500.g2o", 1.0),
    "parking-garage": ("pose_graphs/parking-garage.g2o", 2.0),
    "torus3D": ("pose_graphs/torus3D.g2o", 0.15),
    "city10000": ("pose_graphs/city10000.g2o", 0.4),
}
"""Files below the data folder, and the radius in metres that makes their merged graph at the optimum.

`NAME-stored` takes the estimate that the file stores: of city10000 one whose drift lays streets upon each other.
"""

SIZES = (1000, 3000, 10_000, 30_000, 100_000, 300_000, 1_000_000)
LANCZOS_PAIRS = 300
STORED = "-stored"
SOLVERS = ("poles", "auto", "lanczos", "chebyshev", "dense")


def cases(data: Path | None, largest: int) -> Iterator[str]:
    """Names of the graphs to solve, synthetic graphs up to a size.

    Parameters
    ----------
    data : Path, optional
        Folder of all data.
    largest : int
        Vertices of the largest synthetic graph.
    """
    for n in (size for size in SIZES if size <= largest):
        yield f"chain-{n}"
        if n <= 30_000:
            yield f"laps-{n}"
    yield "random-1000"
    yield from [*REAL, f"city10000{STORED}"] if data is not None else ()


def graphs_of(case: str, data: Path | None) -> tuple[int, Edges, Edges]:
    """Number of vertices, edges of the pose graph, edges of the merged graph.

    Parameters
    ----------
    case : str
    data : Path, optional
        Folder of all data.
    """
    if case.removesuffix(STORED) in REAL:
        name, radius = REAL[case.removesuffix(STORED)]
        dataset = datasets.read(Path(data or ".") / name)
        values = dataset.values if case.endswith(STORED) else optimised(dataset.graph, dataset.values)
        pose_graph = pgti.from_gtsam(dataset.graph, values, radii=radius)
        return len(pose_graph), pose_graph.edges, support_graph(pose_graph).merged_edges
    family, size = case.rsplit("-", 1)
    n, rng = int(size), np.random.default_rng(0)
    edges = {"chain": _chain, "laps": _laps, "random": _random}[family](n, rng)
    first = rng.integers(0, n - 100, size=max(n // 1000, 1))
    inserted = np.stack([first, first + rng.integers(30, 100, size=len(first))], axis=1)
    return n, edges, np.unique(np.concatenate([edges, inserted]), axis=0)


def band(n: int, width: int) -> Edges:
    """Every vertex of a chain tied to the next `width`.

    Parameters
    ----------
    n : int
    width : int
    """
    return np.concatenate([np.stack([np.arange(n - d), np.arange(n - d) + d], axis=1) for d in range(1, width + 1)])


def _chain(n: int, rng: np.random.Generator) -> Edges:
    """Every keyframe sees its ten neighbours on either side."""
    return band(n, 10)


def _laps(n: int, rng: np.random.Generator) -> Edges:
    """Five laps with twenty neighbours, each keyframe tied to the one a lap later."""
    lap = n // 5
    return np.concatenate([band(n, 20), np.stack([np.arange(n - lap), np.arange(n - lap) + lap], axis=1)])


def _random(n: int, rng: np.random.Generator) -> Edges:
    """Uniformly random pairs, mean degree ten, on a path: no geometry to exploit."""
    pairs = np.sort(rng.integers(0, n, size=(4 * n, 2)), axis=1)
    return np.unique(np.concatenate([band(n, 1), pairs[pairs[:, 0] != pairs[:, 1]]]), axis=0)


def solved(case: str, data: Path | None, dense_up_to: int) -> list[Row]:
    """Run the solvers in turn, the leanest first: a peak of memory never falls, so each must exceed the peak before.

    Parameters
    ----------
    case : str
    data : Path, optional
        Folder of all data.
    dense_up_to : int
        Vertices up to which the dense solver runs.
    """
    n, edges, merged = graphs_of(case, data)
    rows, found = [], {}
    before = peak_megabytes()
    for solver in SOLVERS:
        # On a track Chebyshev's order is that of the square root of κ: beyond 300 vertices it takes minutes.
        chebyshev = 1000 if case.startswith("random") else 300
        if n > {"dense": dense_up_to, "lanczos": 10_000, "auto": 10_000, "chebyshev": chebyshev}.get(solver, n):
            continue
        start = time.process_time()
        found[solver] = _SOLVE[solver](n, edges, merged)
        seconds = time.process_time() - start
        sizes = {"case": case, "solver": solver, "n_vertices": n, "n_edges": len(merged)}
        rows.append({**sizes, "seconds": seconds, "peak_megabytes": peak_megabytes() - before, "zeta_error": None})
    for row in rows:
        if "dense" in found and row["solver"] != "dense":
            row["zeta_error"] = float(np.abs(found[row["solver"]] - found["dense"]).max())
    return rows


def by_the_clock(case: str, data: Path | None) -> list[Row]:
    """Shortest time by the clock of five runs of the dense solver, on the cores that BLAS may use (section 6.4).

    Parameters
    ----------
    case : str
    data : Path, optional
        Folder of all data.
    """
    n, edges, merged = graphs_of(case, data)
    seconds = []
    for _ in range(5):
        start = time.perf_counter()
        zeta_of(n, edges, merged, "dense")
        seconds.append(time.perf_counter() - start)
    return [{"case": case, "n_vertices": n, "n_edges": len(merged), "seconds": min(seconds)}]


def zeta_of(n: int, edges: Edges, merged: Edges, method: Any) -> NDArray[np.float64]:
    """ζ of every vertex (Eq. 17), and the diagonals that the stable score takes.

    Parameters
    ----------
    n : int
    edges, merged : (m, 2) int
    method : object
    """
    kernel_p, kernel_m = heat_kernels(n, edges, merged, method=method)
    times = time_grid(kernel_m, 100)
    zeta = relative_distortion(kernel_p.signatures(times), kernel_m.signatures(times), 2)
    kernel_p.diagonals(STABLE_TIMES), kernel_m.diagonals(STABLE_TIMES)
    return zeta


def _lanczos_zeta(n: int, edges: Edges, merged: Edges) -> NDArray[np.float64]:
    """ζ from the lowest eigenpairs only, as section 6.4 of the paper suggests."""
    matrices = [laplacian(n, graph) for graph in (edges, merged)]
    spectra = [eigsh(matrix, k=min(LANCZOS_PAIRS, n - 2), sigma=-1e-6, which="LM") for matrix in matrices]
    largest = float(eigsh(matrices[1], k=1, which="LA", return_eigenvectors=False)[0])
    span = 4 * np.log(10)
    times = np.geomspace(span / largest, span / np.sort(spectra[1][0])[1], 100)
    signatures = []
    for values, vectors in spectra:
        order = np.argsort(values)[1:]
        decay = np.exp(-np.outer(values[order], times))
        signatures.append(vectors[:, order] ** 2 @ decay / decay.sum(axis=0))
    return relative_distortion(signatures[0], signatures[1], 2)


def _chebyshev_zeta(n: int, edges: Edges, merged: Edges) -> NDArray[np.float64]:
    """ζ by PyGSP's Chebyshev filters on a unit of heat at every vertex; its heat kernel is exp(−s λ/λ_max).

    The order grows as the square root of t λ_max, as exp(−t λ) demands of a polynomial.
    """
    times = time_grid(heat_kernels(n, merged)[0], 100)
    signatures = []
    for graph in (edges, merged):
        domain = graphs.Graph(sparse.csr_matrix(adjacency(n, graph)))
        domain.estimate_lmax()
        heat = filters.Heat(domain, scale=times * domain.lmax)
        order = int(np.ceil(4 * np.sqrt(times[-1] * domain.lmax)))
        diagonal = np.empty((n, len(times)))
        for start in range(0, n, 50):
            part = np.arange(start, min(start + 50, n))
            units = np.zeros((n, len(part)))
            units[part, np.arange(len(part))] = 1
            kept = heat.filter(units, method="chebyshev", order=order)
            diagonal[part] = kept[part, np.arange(len(part))]
        positive = diagonal - 1 / n  # all graphs that are small enough are connected
        signatures.append(positive / positive.sum(axis=0))
    return relative_distortion(signatures[0], signatures[1], 2)


def peak_megabytes() -> float:
    """Largest memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


_SOLVE: dict[str, Callable[[int, Edges, Edges], NDArray[np.float64]]] = {
    "auto": lambda n, edges, merged: zeta_of(n, edges, merged, "auto"),
    "poles": lambda n, edges, merged: zeta_of(n, edges, merged, "poles"),
    "dense": lambda n, edges, merged: zeta_of(n, edges, merged, "dense"),
    "lanczos": _lanczos_zeta,
    "chebyshev": _chebyshev_zeta,
}
