"""Figures 3 and 6: heat on either graph, and the counterparts of Table 4 coloured by ζ; and scores as maps grow."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.collections import LineCollection

from pgti_gtsam import outputs

SIGNED = ("(b)", "(h)")
"""Rows whose signatures are drawn: a global error, and incomplete fusion."""


def draw_maps(found: Sequence[dict[str, Any]], path: Path) -> None:
    """A map for each row of the table, brighter where ζ is larger, inserted edges in red.

    Parameters
    ----------
    found : sequence of mapping
        Rows of the table, with maps.
    path : Path
    """
    # a panel a map
    columns = 4
    height = -(-len(found) // columns)
    figure, axes = plt.subplots(height, columns, figsize=(14, 3.3 * height), layout="constrained", squeeze=False)
    for axis, row in zip(axes.flat, found, strict=False):
        first, positions, scores = row["layouts"][0], np.array(row["map"]["positions"]), np.array(row["map"]["scores"])
        pairs = np.array(row["map"]["inserted"], dtype=int)
        axis.add_collection(LineCollection(list(positions[pairs]), colors="#d7263d", linewidths=0.8, zorder=3))
        order = np.argsort(scores)
        dots = axis.scatter(*positions[order].T, c=scores[order], s=6, cmap="viridis", vmin=0, zorder=2)
        figure.colorbar(dots, ax=axis, shrink=0.7)
        axis.set_title(
            f"{row['name']}: Λ {first['score']:.2f} (paper {row['paper']['score']:.2f})\n{row['what']}", fontsize=8
        )
        axis.set_aspect("equal", adjustable="datalim")
        axis.tick_params(labelsize=6)

    # empty panels
    for axis in axes.flat[len(found) :]:
        axis.axis("off")
    with outputs.drawn(path) as part:
        figure.savefig(part, dpi=90)
    plt.close(figure)


def draw_signatures(found: Sequence[dict[str, Any]], path: Path) -> None:
    """The signatures of the worst keyframe in G_p and in G_m, of the rows of `SIGNED`: differing late, and early.

    Parameters
    ----------
    found : sequence of mapping
        Rows of the table, with maps.
    path : Path
    """
    rows = [next(row for row in found if row["name"].startswith(name)) for name in SIGNED]
    figure, axes = plt.subplots(1, len(rows), figsize=(10, 3.4), layout="constrained")
    for axis, row in zip(axes, rows, strict=True):
        times, before, after = (np.array(row["map"][name]) for name in ("times", "before", "after"))
        axis.fill_between(times, before, color="#f2a6b5", alpha=0.35, lw=0)
        axis.fill_between(times, before, after, facecolor="none", edgecolor="#d7263d", hatch="///", lw=0)
        axis.plot(times, before, lw=1.2, label="in G_p")
        axis.plot(times, after, lw=1.2, label="in G_m")
        axis.set(xscale="log", xlabel="t", title=f"{row['name']}: Λ {row['layouts'][0]['score']:.2f}")
    axes[0].set_ylabel("scaled HKS of the worst keyframe")
    axes[0].legend(fontsize=8)
    with outputs.drawn(path) as part:
        figure.savefig(part, dpi=90)
    plt.close(figure)


def draw_growth(found: Sequence[dict[str, Any]], path: Path) -> None:
    """Each score, relative to the small map's, against the map's size: away from the defect, and at its own end.

    Parameters
    ----------
    found : sequence of mapping
        Rows of `growth`.
    path : Path
    """
    # a panel a score and an end
    names = {"score": "Λ", "stable_score": "stable score", "near_score": "Λ of neighbourhoods", "detour": "detour"}
    figure, axes = plt.subplots(2, len(names), figsize=(13, 5.6), layout="constrained", sharex=True, sharey=True)
    for line, end, where in zip(axes, ("far", "near"), ("away from the defect", "at the defect's end"), strict=True):
        for axis, (name, title) in zip(line, names.items(), strict=True):
            for defect in dict.fromkeys(row["defect"] for row in found):
                own = [row for row in found if row["defect"] == defect and row["end"] in (end, "none")]
                kept = [row[name] / own[0][name] for row in own]
                axis.plot([row["growth"] for row in own], kept, marker="o", ms=3, lw=1, label=defect)
            axis.axhline(1, color="grey", lw=0.6, ls=":")
            axis.set_xscale("log")
            axis.set_title(f"{title}, grown {where}", fontsize=9)
            axis.set_xticks([1, 4, 16, 64], ["1", "4", "16", "64"])
            axis.minorticks_off()

    # axes
    axes[0, 0].legend(fontsize=7)
    axes[0, 0].set(ylim=(0, 1.6), ylabel="part of the small map's")
    axes[1, 0].set(xlabel="map, times the small one", ylabel="part of the small map's")
    with outputs.drawn(path) as part:
        figure.savefig(part, dpi=90)
    plt.close(figure)
