"""Means over seeds, with intervals, as Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np


def mean_and_interval(found: Sequence[float], seed: int = 0) -> tuple[float, float, float]:
    """Mean, and its 95 % bootstrap interval.

    Parameters
    ----------
    found : sequence of float
    seed : int
        Of the bootstrap.
    """
    random, array = np.random.default_rng(seed), np.asarray(found, dtype=float)
    means = random.choice(array, (2000, len(array))).mean(axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    return float(array.mean()), float(low), float(high)


def table(rows: Sequence[dict[str, Any]], by: str, measure: str = "f1") -> str:
    """Means of a measure by method and by the values of a key; the worst mean, and an interval of all.

    A trial without an answer counts as zero; where there are any, a last column counts them.

    Parameters
    ----------
    rows : sequence of mapping
    by : str
        Key of the rows by which means are taken.
    measure : str
        Key of the averaged number.
    """
    columns = list(dict.fromkeys(row[by] for row in rows))
    ends = ["worst", "all", *(["no answer"] if any("failed" in row for row in rows) else [])]
    lines = [f"| method | {' | '.join(map(str, [*columns, *ends]))} |", "|---|" + "---|" * (len(columns) + len(ends))]
    for method in dict.fromkeys(row["method"] for row in rows):
        own = [row for row in rows if row["method"] == method and row.get(measure) is not None]
        if not own:
            continue
        found = [[row[measure] for row in own if row[by] == column] for column in columns]
        means = [float(np.mean(values)) for values in found if values]
        cells = [f"{np.mean(values):.2f}" if values else "–" for values in found]
        mean, low, high = mean_and_interval([row[measure] for row in own])
        cells += [f"{min(means):.2f}", f"{mean:.2f} [{low:.2f}, {high:.2f}]"]
        if "no answer" in ends:
            cells.append(f"{sum('failed' in row for row in own)} of {len(own)}")
        lines.append(f"| {method} | {' | '.join(cells)} |")
    return "\n".join(lines)


def ambiguities(rows: Sequence[dict[str, Any]]) -> str:
    """Share of keyframes whose place has a look-alike: mean, least and largest over the seeds of every world."""
    known = {(row["world"], row["seed"]): row["ambiguity"] for row in rows if "ambiguity" in row}
    lines = ["| world | look-alikes | least | largest | drives |", "|---|---|---|---|---|"]
    for world in dict.fromkeys(world for world, _ in known):
        own = [share for (name, _), share in known.items() if name == world]
        lines.append(f"| {world} | {np.mean(own):.2f} | {min(own):.2f} | {max(own):.2f} | {len(own)} |")
    return "\n".join(lines)


def summary(rows: Sequence[dict[str, Any]]) -> str:
    """Everything else that is measured, by method."""
    head = (
        "| method | AUC | true accepted | false accepted | without overlap | success | ATE m | RPE m | ms a closure |"
    )
    lines = [head, "|---|" + "---|" * 8]
    for method in dict.fromkeys(row["method"] for row in rows):
        # measures of a method
        own = [row for row in rows if row["method"] == method]
        known = [row for row in own if "failed" not in row]
        areas = [row["auc"] for row in known if row["auc"] is not None]

        def total(name: str, own: list[dict[str, Any]] = own) -> int:
            return sum(row.get(name, 0) for row in own)

        def median(name: str, known: list[dict[str, Any]] = known) -> float:
            return float(np.median([row[name] for row in known])) if known else np.nan

        # a line
        lines.append(
            f"| {method} | {np.mean(areas) if areas else np.nan:.2f} | {total('true_accepted')} of {total('true')} | "
            f"{total('false_accepted')} of {total('false')} | "
            f"{total('false_without_overlap_accepted')} of {total('false_without_overlap')} | "
            f"{np.mean([row['success'] for row in own]):.2f} | {median('ate_m'):.2f} | {median('rpe_m'):.2f} | "
            f"{1000 * median('seconds_per_closure'):.2g} |"
        )
    return "\n".join(lines)
