"""A replay as a figure for a paper, laid out as the paper's Fig. 4: the map with its scores, and a panel a metric."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam import outputs
from pgti_gtsam.errors import InvalidOptionError, MissingDependencyError

PANELS = (
    ("d", "ΔD"),
    ("t", "ΔT"),
    ("e_tilde", "ΔẼ"),
    ("e", "ΔE"),
    ("mean_score", "Z̄"),
    ("score", "Λ"),
)
_NORMALISED = {"d", "t", "e_tilde", "e"}


def require_png(path: Path | None) -> None:
    """Refuse a picture that could not be drawn, before anything is computed.

    Raises
    ------
    InvalidOptionError
        The file's name does not end in ".png".
    MissingDependencyError
        matplotlib is not installed.
    """
    if path is None:
        return
    if path.suffix.lower() != ".png":
        raise InvalidOptionError(f'expected a file name that ends in ".png", got {str(path)!r}')
    _pyplot()


def write_replay_png(document: Mapping[str, Any], path: Path | str) -> None:
    """Draw a replay's document; the keyframes have their scores of the last moment.

    Parameters
    ----------
    document : mapping
        As `report.replay` makes it.
    path : Path or str

    Raises
    ------
    MissingDependencyError
        matplotlib is not installed.
    """
    plt, moments = _pyplot(), document["moments"]
    with plt.rc_context({"font.size": 8, "axes.spines.top": False, "axes.spines.right": False}):
        figure = plt.figure(figsize=(9, 4.6), layout="constrained")
        grid = figure.add_gridspec(len(PANELS) + 1, 2, width_ratios=(1, 1.15))
        _map(figure, figure.add_subplot(grid[:, 0]), document)

        # a panel a metric, the criteria as parts of their largest change
        x, first = moments["n_keyframes"], None
        for row, (name, symbol) in enumerate(PANELS):
            axis = figure.add_subplot(grid[row, 1], sharex=first)
            first = first or axis
            values = _finite(moments[name])
            axis.plot(x, values / (np.nanmax(values) or 1.0) if name in _NORMALISED else values, lw=1, color="#31688e")
            axis.set_ylabel(symbol, rotation=0, ha="right", va="center")
            axis.tick_params(labelbottom=False)
            axis.set_ylim(bottom=0)

        # when edges were inserted
        axis = figure.add_subplot(grid[-1, 1], sharex=first)
        axis.fill_between(x, np.array(moments["n_new"]) > 0, step="pre", color="#d7263d", lw=0)
        axis.set_ylabel("edges\ninserted", rotation=0, ha="right", va="center")
        axis.set(xlabel="keyframes", yticks=[], ylim=(0, 1.1))
        with outputs.drawn(path) as part:
            figure.savefig(part, dpi=200)
        plt.close(figure)


def _map(figure: Any, axis: Any, document: Mapping[str, Any]) -> None:
    """The map along its two largest axes, the longer axis across, as on the page."""
    from matplotlib.collections import LineCollection

    positions = np.array(document["keyframes"]["position"])
    shown = positions[:, np.argsort(-np.ptp(positions, axis=0), kind="stable")[:2]]
    for name, colour, width in (("pose_graph", "#2f6fdb", 0.25), ("inserted", "#d7263d", 0.6)):
        pairs = np.array(document["edges"][name], dtype=np.int64).reshape(-1, 2)
        axis.add_collection(LineCollection(list(shown[pairs]), colors=colour, linewidths=width, alpha=0.5))
    scores = last_levels(document)
    order = np.argsort(scores, kind="stable")
    dots = axis.scatter(*shown[order].T, c=scores[order], s=7, cmap="viridis", zorder=3, vmin=0)
    figure.colorbar(dots, ax=axis, label="ζ", shrink=0.6)
    axis.set(aspect="equal", xlabel="m", title=document["input"]["name"])
    axis.title.set_parse_math(False)


def last_levels(document: Mapping[str, Any]) -> NDArray[np.float64]:
    """ζ of every keyframe at the last moment, to a 254th of the largest; infinite scores at the top, (n,)."""
    levels = np.frombuffer(base64.b64decode(document["levels"]), dtype=np.uint8)
    last = levels[-document["moments"]["n_keyframes"][-1] :].astype(float)
    return np.minimum(last / 254, 1.0) * float(document["tops"][-1])


def _finite(values: list[float | str]) -> NDArray[np.float64]:
    return np.array([np.nan if value == "infinite" else value for value in values], dtype=float)


def _pyplot() -> Any:
    try:
        import matplotlib

        matplotlib.use("agg")
        from matplotlib import pyplot
    except ImportError:
        raise MissingDependencyError(
            "expected matplotlib for a picture; install it with pip install 'pgti-gtsam[figures]'"
        ) from None
    return pyplot
