"""A dozen maps: the truth, and the map as diagnosed, with places coloured by kind. Chosen and drawn from the rows."""

from __future__ import annotations

import functools
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from pgti_gtsam import outputs
from pgti_gtsam.diagnosis import diagnose
from scenarios.diagnosis import trials
from scenarios.diagnosis.tables import known
from scenarios.diagnosis.trials import Trial
from scenarios.worlds.solid import Array

COLOURS = {
    "likely false closure": "tab:red",
    "undecided contact": "tab:olive",
    "missed closure": "tab:blue",
    "untied second pass": "tab:cyan",
    "tracking gap": "tab:purple",
    "different view": "tab:brown",
    "incomplete fusion": "tab:green",
}

N_MAPS, N_COLUMNS = 12, 3


def chosen(rows: Sequence[dict[str, Any]]) -> list[Trial]:
    """A right verdict of every damage, each in another world where possible; then wrong verdicts."""
    found: list[dict[str, Any]] = []
    for damage in dict.fromkeys(row["damage"] for row in known(rows)):
        own = [row for row in known(rows) if row["damage"] == damage and row["verdict"] == row["expected"]]
        found += sorted(own, key=functools.partial(_interest, [row["world"] for row in found]))[:1]
    seen: list[tuple[str, ...]] = []
    for row in known(rows):
        what = (row["damage"], row["expected"], row["verdict"])
        if row["verdict"] != row["expected"] and what not in seen:
            seen.append(what)
            found.append(row)
    return [Trial(row["world"], row["seed"], row["variant"], row["damage"]) for row in found[:N_MAPS]]


def described(trial: Trial, data: Path | None, row: dict[str, Any]) -> dict[str, Any]:
    """The drawing of a case: plain numbers.

    Parameters
    ----------
    trial : Trial
    data : Path, optional
        Folder of all data.
    row : mapping
        Of the trial.
    """
    case = trials.case(trial, data)
    found = diagnose(case.graph, case.values, radii=case.radii)
    keys = found.pose_graph.keys.tolist()
    false = [[keys.index(key) for key in case.graph.at(slot).keys()] for slot in case.false_slots]  # noqa: SIM118
    return {
        **trial._asdict(),
        "expected": row["expected"],
        "verdict": found.verdict,
        "truth": _flat(case.places).round(1).tolist(),
        "map": _flat(found.pose_graph.positions).round(1).tolist(),
        "false": false,
        "places": [{"kind": place.kind, "stretches": place.keyframes} for place in found.places],
    }


def write(rows: Sequence[dict[str, Any]], data: Path | None, path: Path) -> None:
    """The chosen maps as JSON.

    Parameters
    ----------
    rows : sequence of mapping
    data : Path, optional
        Folder of all data.
    path : Path
    """
    row_of = {Trial(row["world"], row["seed"], row["variant"], row["damage"]): row for row in rows}
    found = [described(trial, data, row_of[trial]) for trial in chosen(rows)]
    outputs.write_text(path, json.dumps(found) + "\n")


def draw(described_maps: Sequence[dict[str, Any]], path: Path) -> None:
    """Truth beside map, three cases a row.

    Parameters
    ----------
    described_maps : sequence of mapping
    path : Path
    """
    n_rows = -(-len(described_maps) // N_COLUMNS)
    figure, axes = plt.subplots(
        n_rows, 2 * N_COLUMNS, figsize=(6 * N_COLUMNS, 3.1 * n_rows + 0.5), layout="constrained", squeeze=False
    )
    for axis in axes.flat:
        axis.axis("off")
    for k, each in enumerate(described_maps):
        truth, drawn = axes.reshape(-1, 2)[k]
        _track(truth, np.array(each["truth"]), f"{each['world']} {each['seed']}, {each['variant']}: truth")
        _diagnosed(drawn, each)
    lines = [Line2D([], [], color=colour, lw=3, label=kind) for kind, colour in COLOURS.items()]
    lines.append(Line2D([], [], color="tab:red", lw=1, ls="--", label="false closure put in"))
    figure.legend(handles=lines, loc="outside lower center", ncols=len(lines), fontsize=12, frameon=False)
    with outputs.drawn(path) as part:
        figure.savefig(part, dpi=85)
    plt.close(figure)


def _diagnosed(axis: Axes, each: dict[str, Any]) -> None:
    """The map with its places, places of little weight below the others."""
    # the track under a title
    places = np.array(each["map"])
    is_right = each["verdict"] == each["expected"]
    title = f"{each['damage']}: {each['verdict']}" + ("" if is_right else f"\n(right: {each['expected']})")
    _track(axis, places, title)
    axis.title.set_color("black" if is_right else "tab:red")

    # places, and false closures
    for place in reversed(each["places"]):
        for first, last in place["stretches"]:
            stretch = places[first : last + 1]
            axis.plot(
                *stretch.T,
                color=COLOURS[place["kind"]],
                lw=1.5 if place["kind"] == "incomplete fusion" else 3,
                alpha=0.8,
                solid_capstyle="round",
            )
            if len(stretch) == 1:
                axis.plot(*stretch.T, "o", color=COLOURS[place["kind"]], ms=5)
    for pair in each["false"]:
        axis.plot(*places[pair].T, color="tab:red", lw=1, ls="--", marker="x", ms=6)


def _track(axis: Axes, places: Array, title: str) -> None:
    axis.plot(*places.T, color="0.35", lw=0.8)
    axis.set_title(title, fontsize=12)
    axis.set_aspect("equal", adjustable="datalim")


def _flat(places: Array) -> Array:
    """From above, and aslant, so that storeys lie apart."""
    height = places[:, 2] if places.shape[1] > 2 else np.zeros(len(places))
    return np.stack([places[:, 0] + 0.35 * height, places[:, 1] + 1.2 * height], axis=1)


def _interest(shown: Sequence[str], row: dict[str, Any]) -> tuple[bool, int, int]:
    """The order of choice: an intact map that is right; worlds that are not shown yet; maps with many places."""
    named = sum(place[0] != "incomplete fusion" for place in row["places"])
    return row["damage"] == "nothing" and row["expected"] != "consistent", list(shown).count(row["world"]), -named
