"""Radii from dense maps, point clouds and meshes, by Open3D, imported when a function is called."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from pgti_gtsam.errors import FileFormatError, InvalidValueError, MissingDependencyError

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

HOW_TO_INSTALL = (
    'install Open3D with  pip install "pgti-gtsam[scene]"  and, on Debian and Ubuntu, its system libraries with  '
    "apt install libusb-1.0-0 libvulkan1 mesa-vulkan-drivers"
)


def radii_from_cloud(positions: ArrayLike, cloud_path: Path | str) -> FloatArray:
    """Return how far each keyframe is from a dense map: from the nearest triangle of a mesh or point of a cloud.

    Parameters
    ----------
    positions : (n, 3) array_like
        Keyframes, in the dense map's frame and unit (m).
    cloud_path : Path or str
        A mesh or point cloud that Open3D reads, for instance .ply, .pcd, .obj or .stl.

    Returns
    -------
    (n,) ndarray
        Radii in m of the minimum spheres (section 3.1 of the paper, with the dense map in place of the landmarks).

    Raises
    ------
    FileFormatError
        The file cannot be read, or holds no finite point.
    InvalidValueError
        The positions have another shape or are not finite.
    MissingDependencyError
        Open3D or a system library is missing.
    """
    queries = np.asarray(positions, dtype=np.float64)
    if queries.ndim != 2 or queries.shape[1] != 3 or not np.isfinite(queries).all():
        raise InvalidValueError(f"expected finite positions of shape (n, 3), got shape {queries.shape}")
    vertices, triangles = _read_dense_map(load_open3d(), Path(cloud_path))
    if len(triangles):
        return _distances_to_triangles(load_open3d(), queries, vertices, triangles)
    return np.asarray(cKDTree(vertices).query(queries)[0], dtype=np.float64)


def _read_dense_map(open3d: Any, path: Path) -> tuple[FloatArray, IntArray]:
    """Return the points (n, 3) and triangles (m, 3), m = 0 for a cloud, of a file."""
    if not path.is_file():
        raise FileFormatError(path, "expected a point cloud or mesh, found no such file")
    with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
        contents = open3d.io.read_file_geometry_type(str(path))
        if contents & open3d.io.CONTAINS_TRIANGLES:
            mesh = open3d.io.read_triangle_mesh(str(path))
            vertices, triangles = np.asarray(mesh.vertices), np.asarray(mesh.triangles, dtype=np.int64)
        else:
            vertices, triangles = np.asarray(open3d.io.read_point_cloud(str(path)).points), np.empty((0, 3), np.int64)
    finite = np.isfinite(vertices).all(axis=1)
    if not finite.any():
        raise FileFormatError(path, "expected a point cloud or mesh that Open3D reads, found no finite point in it")
    if len(triangles) == 0:
        return vertices[finite], triangles
    return vertices, triangles[finite[triangles].all(axis=1)]


def _distances_to_triangles(open3d: Any, queries: FloatArray, vertices: FloatArray, triangles: IntArray) -> FloatArray:
    """Return the distance of each query (n, 3) to a mesh; centred first, since Open3D casts rays in float32."""
    centre = vertices[triangles[:, 0]].mean(axis=0)
    corners, points = ((p - centre).astype(np.float32) for p in (vertices, queries))
    scene, tensor = open3d.t.geometry.RaycastingScene(), open3d.core.Tensor
    scene.add_triangles(tensor(corners), tensor(triangles.astype(np.uint32)))
    return np.asarray(scene.compute_distance(tensor(points)).numpy(), dtype=np.float64)


def load_open3d() -> Any:
    """Import Open3D; raises ImportError or OSError where a system library is missing."""
    try:
        import open3d
    except (ImportError, OSError) as error:
        raise MissingDependencyError(f"Open3D cannot be loaded ({error}): {HOW_TO_INSTALL}") from error
    return open3d
