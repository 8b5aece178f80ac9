"""Radii from point clouds and meshes are distances to them."""

import numpy as np
import pytest
from optional import needs_open3d
from scipy.spatial.distance import cdist

from pgti_gtsam.dense_map import radii_from_cloud
from pgti_gtsam.errors import FileFormatError, InvalidValueError


def ply(path, vertices, faces=()):
    """Write a mesh, or a cloud where there are no faces, in PLY."""
    properties = "".join(f"property double {axis}\n" for axis in "xyz")
    face_head = f"element face {len(faces)}\nproperty list uchar int vertex_indices\n" if len(faces) else ""
    rows = [" ".join(map(str, v)) for v in vertices] + [f"3 {a} {b} {c}" for a, b, c in faces]
    head = f"ply\nformat ascii 1.0\nelement vertex {len(vertices)}\n{properties}{face_head}end_header\n"
    path.write_text(head + "\n".join(rows) + "\n")
    return path


@needs_open3d
@pytest.mark.parametrize("offset", [0.0, 5e5])
def test_radius_from_a_cloud_is_the_distance_to_its_nearest_point(offset, tmp_path):
    rng = np.random.default_rng(3)
    cloud, positions = rng.normal(size=(200, 3)) + offset, rng.normal(size=(7, 3)) + offset
    radii = radii_from_cloud(positions, ply(tmp_path / "cloud.ply", cloud.tolist()))
    np.testing.assert_allclose(radii, cdist(positions, cloud).min(axis=1), atol=1e-5)


@needs_open3d
@pytest.mark.parametrize("offset", [0.0, 5e5])
def test_radius_from_a_mesh_is_the_distance_to_its_surface(offset, tmp_path):
    """Above a large triangle the distance is the height, though its corners are far."""
    corners = np.array([[-90.0, -90, 0], [90, -90, 0], [0, 120, 0]]) + offset
    positions = np.array([[0, 0, 2.5], [5, 3, -1.0], [0, 0, 0]]) + offset
    radii = radii_from_cloud(positions, ply(tmp_path / "mesh.ply", corners.tolist(), [(0, 1, 2)]))
    np.testing.assert_allclose(radii, [2.5, 1.0, 0.0], atol=1e-4)


@needs_open3d
@pytest.mark.parametrize("text", [None, "", "no cloud\n", "ply\nformat ascii 1.0\nelement vertex 0\nend_header\n"])
@pytest.mark.parametrize("suffix", [".ply", ".pcd", ".txt"])
def test_unreadable_dense_maps_are_refused(text, suffix, tmp_path):
    path = tmp_path / f"map{suffix}"
    if text is not None:
        path.write_text(text)
    with pytest.raises(FileFormatError, match="expected a point cloud or mesh"):
        radii_from_cloud([[0, 0, 0]], path)


@pytest.mark.parametrize("positions", [[0, 0, 0], [[0, 0]], [[0, np.nan, 0]]])
def test_positions_are_checked(positions):
    with pytest.raises(InvalidValueError, match="expected finite positions"):
        radii_from_cloud(positions, "cloud.ply")
