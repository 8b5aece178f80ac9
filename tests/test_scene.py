"""Pictures of a map. Open3D runs apart: where a driver is missing it ends the process."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest
from optional import MISSING, needs_open3d

from pgti_gtsam.errors import InvalidOptionError, MissingDependencyError
from pgti_gtsam.report import scene

BLUE, RED = np.multiply(255, scene._BLUE), np.multiply(255, scene._RED)
YELLOW, VIOLET = (253, 231, 37), (68, 1, 84)  # the ends of Viridis: the largest ζ, and none


def document(planar):
    """A ring of 24 keyframes whose ends meet unconnected; the score is largest at the gap."""
    n = 24
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    positions = np.c_[10 * np.cos(angle), 10 * np.sin(angle), np.zeros(n) if planar else np.sin(angle)]
    score = [0.0] * n
    score[0], score[-1] = "infinite", 0.8
    place = {"keyframes": [0, n - 1]}
    return {
        "schema": "pgti-gtsam/audit", "schema_version": 2, "input": {"name": "ring"}, "places": [place],
        "keyframes": {"position": positions.tolist(), "radius": [1.5] * n, "score": score},
        "edges": {"pose_graph": [[i, i + 1] for i in range(n - 1)], "collisions": [[0, n - 1]]},
    }  # fmt: skip


def drawn(audit, folder, **size):
    """The picture (h, w, 3) of an audit, rendered in a process of its own; skips where no driver is installed."""
    (folder / "audit.json").write_text(json.dumps(audit))
    program = (
        "import json, sys\nfrom pgti_gtsam.errors import MissingDependencyError\nfrom pgti_gtsam.report import scene\n"
        f"try:\n    scene.render_png(json.load(open('audit.json')), 'map.png', **{size!r})\n"
        "except MissingDependencyError as error:\n    sys.exit(f'missing: {error}')\n"
        "import numpy, open3d\nnumpy.save('map.npy', numpy.asarray(open3d.io.read_image('map.png')))\n"
    )
    run = subprocess.run([sys.executable, "-c", program], cwd=folder, capture_output=True, text=True, timeout=300)
    if "missing: " in run.stderr:
        pytest.skip(run.stderr.rpartition("missing: ")[2].strip())
    assert run.returncode == 0, run.stderr
    assert "FEngine" not in run.stdout + run.stderr  # what the engine prints goes to the log
    return np.load(folder / "map.npy")


def share(image, color, tolerance=12):
    """Share of the pixels that have a colour."""
    return (np.abs(image.astype(float) - color).max(axis=2) <= tolerance).mean()


@needs_open3d
@pytest.mark.parametrize("planar", [True, False], ids=["planar", "in space"])
def test_picture_shows_each_layer_in_its_colour(planar, tmp_path):
    audit = document(planar)
    audit["places"] = []  # spheres would tint what they cover
    image = drawn(audit, tmp_path, width=480, height=320)
    assert image.shape == (320, 480, 3)
    assert 0.5 < share(image, (255, 255, 255)) < 0.99
    assert all(share(image, color) > 1e-4 for color in (BLUE, RED, YELLOW, VIOLET))
    assert share(image, (40, 40, 40)) > 1e-4  # the bar
    assert all((image[edge] > 250).all() for edge in (0, -1, (slice(None), 0), (slice(None), -1)))


def test_a_legend_says_colours_and_size():
    said = scene.legend(document(True))
    assert "to 0.8, yellow" in said
    assert "m long" in said


@needs_open3d
def test_spheres_of_the_worst_places_are_translucent(tmp_path):
    image = drawn(document(True), tmp_path, width=480, height=320)
    tint = 255 * (1 - scene._BALL_OPACITY) + scene._BALL_OPACITY * np.multiply(255, scene._BALL)
    assert share(image, tint) > 0.005


@needs_open3d
@pytest.mark.parametrize("n", [1, 2])
def test_maps_of_one_place_are_drawn(n, tmp_path):
    audit = document(True)
    audit["keyframes"] = {"position": [[7.0, 7.0, 0.0]] * n, "radius": [0.0] * n, "score": [0.0] * n}
    audit["edges"] = {"pose_graph": [[0, 1]][: n - 1], "collisions": [[0, 1]][: n - 1]}
    audit["places"] = [{"keyframes": [0]}]
    assert share(drawn(audit, tmp_path, width=60, height=40), VIOLET) > 0


@pytest.mark.parametrize("aspect", [0.5, 1.0, 3.0])
@pytest.mark.parametrize("planar", [True, False], ids=["planar", "in space"])
def test_camera_sees_every_keyframe_and_wastes_no_room(planar, aspect):
    read = scene._read(document(planar))
    eye, centre, up = scene._camera(read, aspect)
    forward = (centre - eye) / np.linalg.norm(centre - eye)
    right = np.cross(forward, up) / np.linalg.norm(np.cross(forward, up))
    rays = read.positions - eye
    seen = np.stack([rays @ right / aspect, rays @ np.cross(right, forward)], axis=1) / (rays @ forward)[:, None]
    reach = np.abs(seen).max() / np.tan(np.radians(scene._FIELD_OF_VIEW_DEG / 2))
    assert 0.8 < reach <= 1


def test_window_needs_a_display(monkeypatch):
    if MISSING or not sys.platform.startswith("linux"):
        pytest.skip(f"needs Open3D on Linux: {MISSING}")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(MissingDependencyError, match="--png"):
        scene.show(document(True))


def test_missing_open3d_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(MissingDependencyError, match=r"pgti-gtsam\[scene\].*libusb-1.0-0 libvulkan1"):
        scene.render_png(document(True), "map.png")


@pytest.mark.parametrize(("path", "width"), [("map.png", 0), ("map.jpg", 100)])
def test_unusable_pictures_are_refused(path, width):
    with pytest.raises(InvalidOptionError, match="expected"):
        scene.render_png(document(True), path, width=width)
