"""The window on a map and the `view` command; nothing is rendered."""

import ctypes
import sys

import numpy as np
import pytest
from optional import needs_open3d
from test_cli import SQUARE
from test_scene import document

from pgti_gtsam.errors import MissingDependencyError, OutputError
from pgti_gtsam.report import scene


@needs_open3d
@pytest.mark.parametrize("has_places", [True, False])
def test_a_window_shows_the_layers_and_spheres_where_there_are_places(monkeypatch, has_places):
    import open3d

    shown = []
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(open3d.visualization, "draw", lambda layers, **how: shown.append((layers, how)))
    audit = document(True)
    audit["places"] = audit["places"] if has_places else []
    scene.show(audit)
    ((layers, how),) = shown
    names = [layer["name"] for layer in layers]
    assert ("minimum spheres" in names) is has_places
    assert len(names) == len(set(names)) >= 3
    assert how["title"] == "pgti-gtsam: ring"
    np.testing.assert_allclose(how["up"], [0, 1, 0])


@needs_open3d
def test_a_picture_that_open3d_cannot_write_is_told_and_leaves_nothing(monkeypatch, tmp_path):
    import open3d

    monkeypatch.setattr(scene, "_require_vulkan", lambda: None)
    monkeypatch.setattr(scene, "_rendered", lambda *_: np.zeros((4, 4, 3), dtype=np.uint8))
    monkeypatch.setattr(open3d.io, "write_image", lambda *_: False)
    with pytest.raises(OutputError, match="Open3D made no picture"):
        scene.render_png(document(True), tmp_path / "map.png")
    assert list(tmp_path.iterdir()) == []


def test_a_missing_driver_is_told_before_the_renderer_ends_the_process(monkeypatch):
    class Vulkan:
        def vkCreateInstance(self, *_):
            return -9  # VK_ERROR_INCOMPATIBLE_DRIVER

    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(ctypes, "CDLL", lambda _: Vulkan())
    with pytest.raises(MissingDependencyError, match="no Vulkan driver is installed"):
        scene._require_vulkan()

    def absent(_):
        raise OSError("no such file")

    monkeypatch.setattr(ctypes, "CDLL", absent)
    with pytest.raises(MissingDependencyError, match=r"cannot be loaded \(no such file\)"):
        scene._require_vulkan()
    monkeypatch.setattr(sys, "platform", "darwin")  # Metal
    scene._require_vulkan()


@pytest.mark.parametrize(("flat", "up"), [(1, [0, -1, 0]), (2, [0, 0, 1])])
def test_a_map_of_camera_poses_stands_upright(flat, up):
    """The y axis of cameras points down, the z axis of robots up."""
    audit = document(False)
    positions = np.array(audit["keyframes"]["position"])
    positions = positions if flat == 2 else positions[:, [0, 2, 1]]
    audit["keyframes"]["position"] = positions.tolist()
    _, _, found = scene._camera(scene._read(audit), 1.6)
    np.testing.assert_allclose(found, up)


@pytest.mark.parametrize("as_picture", [True, False])
def test_the_command_shows_a_window_or_writes_a_picture(run, monkeypatch, tmp_path, as_picture):
    called = []
    monkeypatch.setattr(scene, "show", lambda audit: called.append((audit, None)))
    monkeypatch.setattr(scene, "render_png", lambda *given: called.append(given))
    (tmp_path / "square.g2o").write_text(SQUARE)
    png = tmp_path / "map.png"
    code, out, _ = run("view", tmp_path / "square.g2o", "--radius", 1, *(["--png", png] if as_picture else []))
    ((audit, path),) = called
    assert (code, path) == (0, png if as_picture else None)
    assert audit["summary"]["n_keyframes"] == 5
    assert ("picture: " in out) is as_picture
    assert ("m long" in out) is as_picture
