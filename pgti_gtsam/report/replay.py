"""A replay as a JSON document, and the page drawn from the document: the map beside its curves, and a slider."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam import encode, outputs
from pgti_gtsam.replaying import METRICS, Replay
from pgti_gtsam.report import web
from pgti_gtsam.report.digits import in_stable_digits
from pgti_gtsam.report.document import Document
from pgti_gtsam.support_graph import support_graph

_SCRIPTS = ("text.js", "errors.js", "plots.js", "replay.js")
_COUNTS = ("n_keyframes", "n_edges", "n_inserted", "n_collisions", "n_new", "worst")
_LEVELS = 254
"""Steps of the colour scale; one byte a keyframe and moment, of which 255 stands for an infinite score."""


@in_stable_digits
def replay_document(replay: Replay, *, name: str, file_format: str, notes: Sequence[str] = ()) -> Document:
    """Put a replay into a JSON-ready mapping.

    Scores become levels of a colour scale from zero to the largest finite score of the moment. Edges are those of the
    end; edges are left out where the estimate moved, since earlier edges differed.

    Parameters
    ----------
    replay : Replay
    name, file_format : str
        Name of the map, and its file format.
    notes : sequence of str
        Notes on the input.
    """
    # whether the estimate moved, and colours
    pose_graph, final = replay.pose_graph, replay.pose_graph.positions.astype(np.float32)
    still = all((moment.positions == final[: moment.n_keyframes]).all() for moment in replay.moments)
    tops = [_top(moment.keyframe_scores) for moment in replay.moments]
    levels = [_levels(moment.keyframe_scores, top) for moment, top in zip(replay.moments, tops, strict=True)]
    support = support_graph(pose_graph) if still else None

    # the map, and its curves
    return {
        **encode.heading("replay-page", 1),
        "input": {"name": name, "format": file_format, "notes": list(notes)},
        "keyframes": {"label": pose_graph.labels, "position": np.round(pose_graph.positions, 4).tolist()},
        "edges": {
            "pose_graph": [] if support is None else pose_graph.edges.tolist(),
            "inserted": [] if support is None else support.inserted_edges.tolist(),
        },
        "moments": {
            **{each: [encode.number(value) for value in replay.curve(each).tolist()] for each in METRICS},
            **{each: replay.curve(each).astype(int).tolist() for each in _COUNTS},
        },
        "lags": [_lag(replay, each) for each in METRICS],
        "tops": tops,
        "levels": _packed(np.concatenate(levels)),
        "positions": None if still else _packed(np.concatenate([moment.positions for moment in replay.moments])),
    }


def write_replay_page(document: Mapping[str, Any], path: Path | str) -> None:
    """Write an HTML file that needs no network; raises as `web.assembled` does.

    Parameters
    ----------
    document : mapping
        As `replay_document` makes it.
    path : Path or str
    """
    page = web.assembled(document, what="map integrity, replayed", body="replay.html", first="lags", scripts=_SCRIPTS)
    outputs.write_text(path, page)


def _top(scores: NDArray[np.float32]) -> float:
    return float(scores[np.isfinite(scores)].max(initial=0.0)) or 1.0


def _levels(scores: NDArray[np.float32], top: float) -> NDArray[np.uint8]:
    levels = np.round(_LEVELS * np.minimum(scores, top) / top).astype(np.uint8)
    levels[np.isinf(scores)] = 255
    return levels


def _lag(replay: Replay, name: str) -> Document:
    found = replay.lags()[name]
    return {
        "metric": METRICS[name],
        "lag": None if np.isnan(found.correlation) else found.lag,
        "correlation": encode.number(found.correlation),
        "at_zero": encode.number(found.at_zero),
    }


def _packed(array: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<")).tobytes()).decode()
