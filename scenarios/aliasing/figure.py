"""Pictures of rows: F1 against what methods are told and against the share of false closures, precision and recall."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from pgti_gtsam import outputs
from scenarios import measures
from scenarios.aliasing.methods import METHODS
from scenarios.aliasing.tables import mean_and_interval
from scenarios.aliasing.trials import SHARES
from scenarios.worlds import ALIKE


def draw(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """All three, each point a mean over worlds and seeds with its interval.

    Parameters
    ----------
    rows : sequence of mapping
    path : Path
    """
    # a curve a method in each panel
    figure, axes = plt.subplots(1, 3, figsize=(16, 4.4), layout="constrained", sharey=True)
    for k, method in enumerate(METHODS):
        style = {"color": f"C{k - 1}", "lw": 1.0, "ls": "-" if k < 6 else "--"}
        if method == "gate":
            style = {"color": "black", "lw": 2.4}
        own = [row for row in rows if row["method"] == method]
        told = [[r["f1"] for r in own if (r["setting"], r["share"]) == (name, 1.0)] for name in ALIKE]
        shares = [[r["f1"] for r in own if (r["setting"], r["share"]) == ("right", share)] for share in SHARES]
        _curve(axes[0], np.arange(len(ALIKE)) + 0.02 * k, told, method, style)
        _curve(axes[1], np.array(SHARES), shares, method, style)
        curves = [r["precisions"] for r in own if (r["setting"], r["share"]) == ("right", 1.0) and "precisions" in r]
        if curves:
            axes[2].plot(measures.RECALLS, np.mean(curves, axis=0), label=method, **style)

    # axes
    axes[0].set_xticks(range(len(ALIKE)), ALIKE)
    axes[0].set(xlabel="sigmas that methods are told", ylabel="F1 of accepted true closures", ylim=(0, 1.05))
    axes[1].set(xlabel="false closures per true one, right sigmas")
    axes[2].set(xlabel="recall", ylabel="precision, right sigmas")
    axes[2].legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    with outputs.drawn(path) as part:
        figure.savefig(part, dpi=110)
    plt.close(figure)


def _curve(axis: Axes, places: Any, found: list[list[float]], label: str, style: dict[str, Any]) -> None:
    there = [k for k, values in enumerate(found) if values]
    if there:
        mean, low, high = np.array([mean_and_interval(found[k]) for k in there]).T
        style = style | {"capsize": 2, "elinewidth": 0.6, "marker": "" if len(there) > 1 else "."}
        axis.errorbar(places[there], mean, [mean - low, high - mean], label=label, **style)
