"""What a pose graph accepts, how it brings it into order, and what it says of the rest."""

import numpy as np
import pytest

import pgti_gtsam as pgti
from pgti_gtsam.errors import InvalidGraphError, InvalidValueError, NoPoseError

LINE = {"keys": [3, 5, 9], "positions": np.eye(3), "edges": [(0, 1), (1, 2)], "radii": 1.0}


def test_edges_come_sorted_and_merged_with_what_belongs_to_them():
    information = np.stack([np.eye(2), 2 * np.eye(2), np.full((2, 2), np.nan)])
    graph = pgti.PoseGraph(
        **{**LINE, "edges": [(2, 1), (1, 2), (1, 0)]},
        edge_sources=[pgti.EdgeSource.BETWEEN, pgti.EdgeSource.TRACK, pgti.EdgeSource.COVISIBILITY],
        edge_slots=((7,), (), ()),
        edge_information=information,
    )
    assert graph.edges.tolist() == [[0, 1], [1, 2]]
    assert graph.edge_sources.tolist() == [
        pgti.EdgeSource.COVISIBILITY,
        pgti.EdgeSource.BETWEEN | pgti.EdgeSource.TRACK,
    ]
    assert graph.edge_slots == ((), (7,))
    np.testing.assert_array_equal(graph.edge_information[1], 3 * np.eye(2))
    assert np.isnan(graph.edge_information[0]).all()


def test_a_plane_lies_at_height_zero_and_one_radius_stands_for_all():
    graph = pgti.PoseGraph(keys=[0, 1], positions=[[1, 2], [3, 4]], edges=[], radii=2)
    assert graph.positions.tolist() == [[1, 2, 0], [3, 4, 0]]
    assert graph.radii.tolist() == [2, 2]
    assert graph.edges.shape == (0, 2)


def test_arrays_are_the_graphs_own_and_read_only():
    positions = np.eye(3)
    graph = pgti.PoseGraph(**{**LINE, "positions": positions})
    positions[0, 0] = 99
    assert graph.positions[0, 0] == 1
    for name in ("keys", "positions", "edges", "radii", "edge_sources"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(graph, name)[0] = 0


def test_labels_are_those_of_gtsam():
    gtsam = pytest.importorskip("gtsam")
    keys = [0, 12, gtsam.symbol("x", 7), gtsam.symbol("A", 123456)]
    graph = pgti.PoseGraph(keys=keys, positions=np.zeros((4, 3)), edges=[], radii=0)
    assert graph.labels == [gtsam.DefaultKeyFormatter(key) for key in keys]


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"keys": [], "positions": np.empty((0, 3))}, NoPoseError, "at least one keyframe"),
        ({"keys": [3, 5, 3]}, InvalidGraphError, "distinct keys, got 3"),
        ({"positions": np.eye(2)}, InvalidGraphError, r"shape \(3, 3\)"),
        ({"positions": [[0, 0, 0], [0, np.nan, 0], [0, 0, 0]]}, InvalidValueError, "keyframe 5"),
        ({"radii": [1, -1, 1]}, InvalidValueError, "-1.0 at keyframe 5"),
        ({"radii": np.inf}, InvalidValueError, "inf at keyframe 3"),
        ({"radii": [1, 1]}, InvalidGraphError, "3 of them"),
        ({"edges": [(0, 3)]}, InvalidGraphError, r"\(0, 3\)"),
        ({"edges": [(1, 1)]}, InvalidGraphError, "two different keyframes"),
        ({"edges": [(0, 1, 2)]}, InvalidGraphError, r"\(m, 2\)"),
        ({"edge_slots": ((1,),)}, InvalidGraphError, "each of the 2 edges"),
        ({"edge_information": np.eye(3)}, InvalidGraphError, r"\(2, d, d\)"),
    ],
)
def test_what_does_not_fit_is_named(change, error, words):
    with pytest.raises(error, match=words):
        pgti.PoseGraph(**{**LINE, **change})
