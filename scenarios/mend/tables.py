"""Tables of mending, from the JSON of the runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any

Row = Mapping[str, Any]


def lines(found: Mapping[str, Sequence[Row]]) -> list[str]:
    """All tables as Markdown."""
    told: list[str] = []

    # logs
    if found.get("logs"):
        head = ["log", "loops", "seed", "given", "ties in", "false in", "false out", "true out", "collisions"]
        rows = [_log(row) for row in found["logs"]]
        told += _table([*head, "ATE before, after, full (m)", "cells before, after, full, published"], rows)

    # what other ties come to
    if found.get("limits"):
        head = ["log", "ties", "number", "ATE (m)", "cells"]
        told += _table(head, [line for row in found["limits"] for line in _limits(row)])

    # ACES
    if found.get("aces"):
        for row in found["aces"]:
            told += [
                f"aces: {row['n_keyframes']} keyframes, {row['confirmed']} ties in {row['seconds']:.0f} s; brute force "
                f"{row['n_brute_force']} fits, with GNC {row['seconds_gnc']:.0f} s; false ties in: {row['false_in']}",
                f"With the relations: {row['verdict_intact']}, and {row['confirmed_intact']} ties in",
                "",
            ]
            errors = [
                [name, *(f"{each[key]:.3f}" for key in ("mean_m", "median_m", "worst_m")), f"{each['mean_deg']:.2f}"]
                for name, each in row["errors"].items()
            ]
            told += _table(["map", "mean (m)", "median (m)", "worst (m)", "mean (deg)"], errors)

    # worlds
    if found.get("worlds"):
        head = ["world", "seed", "keyframes", "ties in", "false in", "wrong floor", "naive: ties, false, wrong floor"]
        rows = [_world(row) for row in found["worlds"]]
        told += _table([*head, "ATE before, after (m)", "verdict", "seconds"], rows)
    if found.get("fits"):
        head = ["constants", "fits of", "true: confirmed of", "slipped: confirmed of", "elsewhere: confirmed of"]
        told += _table([*head, "misses of ties in sigmas: median, 90 %"], [_fits(row) for row in found["fits"]])
    return told


def _fits(row: Row) -> list[str]:
    return [
        row["use"],
        row["name"],
        *(f"{row[f'{kind}_confirmed']} of {row[f'n_{kind}']}" for kind in ("true", "slipped", "elsewhere")),
        ", ".join("–" if row[key] is None else f"{row[key]:.2f}" for key in ("sigmas_median", "sigmas_90")),
    ]


def _log(row: Row) -> list[str]:
    ate, cells, collisions = row["ate_m"], row["cells"], row["collisions"]
    return [
        row["log"],
        row["kind"],
        str(row["seed"]),
        str(row["n_loops"]),
        str(row["confirmed"]),
        str(row["false_in"]),
        f"{row['false_out']} of {row['n_false']}",
        str(row["true_out"]),
        f"{collisions['before']} → {collisions['after']} ({collisions['full']})",
        ", ".join(f"{ate[name]:.3f}" for name in ("before", "after", "full")),
        ", ".join(str(cells[name]) for name in ("before", "after", "full", "published")),
    ]


def _limits(row: Row) -> list[list[str]]:
    number, halves = row["n_loops"], row["halves"]
    maps = [
        ("the published loops", number, row["full"]),
        ("their pairs, with the published poses", number, row["exact"]),
        ("their pairs as matched here", row["n_matched"], row["matched"]),
    ]
    told = [[row["log"], name, str(n), f"{each['ate_m']:.3f}", str(each["cells"])] for name, n, each in maps]
    middle = {key: median(each[key] for each in halves) for key in ("ate_m", "cells")}
    half = ["half of the loops, median", str(number // 2), f"{middle['ate_m']:.3f}", f"{middle['cells']:.0f}"]
    apart = ["one half against the other, median", str(number // 2), f"{median(row['halves_apart_m']):.3f}", ""]
    return [*told, [row["log"], *half], [row["log"], *apart]]


def _world(row: Row) -> list[str]:
    return [
        row["world"],
        str(row["seed"]),
        str(row["n_keyframes"]),
        str(row["confirmed"]),
        str(row["false_in"]),
        str(row["wrong_floor"]),
        f"{row['naive']}, {row['naive_false']}, {row['naive_wrong_floor']}",
        f"{row['ate_before_m']:.2f}, {row['ate_m']:.2f}",
        f"{row['verdict_before']} → {row['verdict']}",
        f"{row['seconds']:.0f}",
    ]


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    ruled = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return [*ruled, *("| " + " | ".join(row) + " |" for row in rows), ""]
