"""Aliasing on streets: every method, every noise model that it may be told, growing shares of false closures.

A trial is one method on one problem. Its row is appended to a file of JSON lines as soon as it is known, and a trial
whose row is there is not run again: a killed run goes on where it stopped, and a killed worker's trials are given
to another.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from dask.distributed import Client, LocalCluster, as_completed

from scenarios import measures
from scenarios.aliasing import field, methods, streets
from scenarios.problem import Problem

Trial = tuple[str, int, str, float, str]
"""World, seed, told, share, method. A world is "streets" or the path of a standard graph."""

SHARES = (0.1, 0.5, 1.0)


def street_trials(seeds: Sequence[int]) -> Iterator[Trial]:
    """All noise models at equal shares, and all shares with the right one."""
    for seed in seeds:
        for told in streets.TOLD:
            for share in SHARES if told == "right" else (1.0,):
                for method in methods.METHODS:
                    yield "streets", seed, told, share, method


def field_trials(paths: Sequence[Path], seeds: Sequence[int]) -> Iterator[Trial]:
    """All shares, with the noise models of the files."""
    for path, seed, share, method in product(paths, seeds, SHARES, methods.METHODS):
        yield str(path), seed, "the file's", share, method


def _problem(world: str, seed: int, told: str, share: float) -> Problem:
    return streets.problem(seed, told, share=share) if world == "streets" else field.problem(Path(world), seed, share)


def run_trial(world: str, seed: int, told: str, share: float, method: str) -> dict[str, Any]:
    """One row."""
    problem = _problem(world, seed, told, share)
    row: dict[str, Any] = {"world": Path(world).stem, "seed": seed, "told": told, "share": share, "method": method}
    try:
        outcome = methods.solve(problem, method)
    except RuntimeError as error:  # what GTSAM raises where its solver gives up
        return row | {"failed": str(error).strip().splitlines()[0][:120], "f1": 0.0}
    seen, kept = problem.overlapping, outcome.accepted
    places = np.array([problem.truth.atPose2(key).translation() for key in range(problem.truth.size())])
    ate = measures.ate_m(problem.truth, outcome.values)
    return row | {
        "true": int(problem.true.sum()),
        "true_accepted": int((problem.true & kept).sum()),
        "false": int((~problem.true).sum()),
        "false_accepted": int((~problem.true & kept).sum()),
        "false_without_overlap": int((~seen).sum()),
        "false_without_overlap_accepted": int((~seen & kept).sum()),
        "f1": measures.f1(problem.true, kept),
        "f1_with_overlap": measures.f1(problem.true[seen], kept[seen]),
        "ate_m": ate,
        "extent_m": float(np.ptp(places, axis=0).max()),
        "success": bool(ate < 0.75 or ate < 0.05 * np.ptp(places, axis=0).max()),
        "seconds_per_closure": outcome.seconds / max(len(kept), 1),
    }


def _run(trial: Trial) -> dict[str, Any]:
    return run_trial(*trial)


def run(
    path: Path, wanted: Sequence[Trial], scheduler: str | None, tell: Callable[[str], None]
) -> list[dict[str, Any]]:
    """Run what the file does not hold yet; all rows, in the order of the trials."""
    path.parent.mkdir(parents=True, exist_ok=True)
    done = {_key(row): row for row in _rows(path)}
    missing = [trial for trial in wanted if _name(trial) not in done]
    tell(f"{len(wanted)} trials, {len(wanted) - len(missing)} of them known")
    if missing:
        cluster = None if scheduler else LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None)
        with Client(scheduler or cluster) as client, path.open("a", encoding="utf-8") as file:
            # nobody keeps a future that is done, else a killed worker's would be computed again
            finished = as_completed(client.map(_run, missing, pure=False), with_results=True)
            for count, (_, row) in enumerate(finished, start=1):
                file.write(json.dumps(row, ensure_ascii=False) + "\n")
                file.flush()
                done[_key(row)] = row
                if count % 50 == 0 or count == len(missing):
                    tell(f"{count} of {len(missing)}")
        if cluster is not None:
            cluster.close()
    return [done[_name(trial)] for trial in wanted]


def _name(trial: Trial) -> Trial:
    """The trial as its row has it, wherever the data lies."""
    return Path(trial[0]).stem, *trial[1:]


def _key(row: dict[str, Any]) -> Trial:
    return row["world"], row["seed"], row["told"], row["share"], row["method"]


def _rows(path: Path) -> Iterator[dict[str, Any]]:
    """Whole rows of the file; a last line that was cut off when the run was killed is cut from it."""
    if not path.is_file():
        return
    text = path.read_text(encoding="utf-8")
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        path.write_text(whole, encoding="utf-8")
    yield from map(json.loads, whole.splitlines())


def mean_and_interval(found: Sequence[float], seed: int = 0) -> tuple[float, float, float]:
    """Mean over seeds, and its 95 % bootstrap interval."""
    random, array = np.random.default_rng(seed), np.asarray(found, dtype=float)
    means = random.choice(array, (2000, len(array))).mean(axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    return float(array.mean()), float(low), float(high)


def table(rows: Sequence[dict[str, Any]], by: str) -> str:
    """Markdown: mean F1 over seeds, by method and by what a key of the rows holds."""
    columns = list(dict.fromkeys(row[by] for row in rows))
    lines = [f"| method | {' | '.join(map(str, columns))} | worst |", "|---|" + "---|" * (len(columns) + 1)]
    for method in methods.METHODS:
        means = [
            float(np.mean([row["f1"] for row in rows if (row["method"], row[by]) == (method, column)]))
            for column in columns
        ]
        lines.append(f"| {method} | {' | '.join(f'{mean:.2f}' for mean in means)} | {min(means):.2f} |")
    return "\n".join(lines)
