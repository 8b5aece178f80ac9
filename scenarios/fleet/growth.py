"""A city audited whole and in parts: the same verdict, time and memory of both; a new process for every row."""

from __future__ import annotations

import hashlib
import json
import os
import resource
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pgti_gtsam.diagnosis import diagnose
from pgti_gtsam.fleet import spread
from pgti_gtsam.parts import DiagnosisInParts, diagnose_parts
from pgti_gtsam.places import Compared
from scenarios.fleet.streets import RADIUS, city

SIZES = (10_000, 30_000, 100_000, 300_000, 1_000_000)
WHOLE_UP_TO = 100_000
CORE = 10_000
"""Keyframes in the core of a part."""

UNTIED = 0.2
"""Share of the districts in which no pass is tied."""

Row = dict[str, Any]


def run(path: Path, sizes: Sequence[int], tell: Callable[[str], None]) -> list[Row]:
    """Make the rows that the file lacks; all rows.

    Parameters
    ----------
    path : Path
        Of JSON lines.
    sizes : sequence of int
        Keyframes.
    tell : callable
    """
    rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.is_file() else []
    for n in sizes:
        for way in ("parts", "whole") if n <= WHOLE_UP_TO else ("parts",):
            if any((row["keyframes"], row["way"]) == (n, way) for row in rows):
                continue
            command = [sys.executable, "-m", "scenarios.fleet.growth", str(n), way]
            done = subprocess.run(command, capture_output=True, text=True, check=True)
            rows.append(json.loads(done.stdout.splitlines()[-1]))
            with path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(rows[-1]) + "\n")
            tell(f"{n} keyframes, {way}: {rows[-1]['cpu_s']} s of processor, {rows[-1]['peak_mb']} MB")
    return rows


def row(n: int, way: str) -> Row:
    """A city audited in one way; parts on a single Dask worker.

    Parameters
    ----------
    n : int
        Keyframes.
    way : {"whole", "parts"}
    """
    # the audit
    built = city(n, untied=UNTIED)
    before, started = time.process_time(), time.monotonic()
    found: Any
    if way == "whole":
        found = diagnose(built.graph, built.values, radii=RADIUS)
        more = _told(found, found.integrity)
    else:
        with spread(workers=1) as each:
            found = diagnose_parts(built.graph, built.values, parts=max(n // CORE, 2), radii=RADIUS, each=each)
        more = _told(found, found.compared) | _of_parts(found)

    # its time and memory
    own, children = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return {
        "keyframes": n,
        "way": way,
        "closures": built.n_closures,
        "cpu_s": round(time.process_time() - before, 1),
        "worker_cpu_s": round(children.ru_utime + children.ru_stime, 1),
        "seconds": round(time.monotonic() - started, 1),
        "load": round(os.getloadavg()[0], 1),
        "peak_mb": round(own.ru_maxrss / 1024),
        "worker_peak_mb": round(children.ru_maxrss / 1024) if way == "parts" else None,
    } | more


def _told(found: Any, compared: Compared) -> Row:
    """Verdict, places and overlaps; without incomplete fusion, a kind that parts do not name."""
    places = [
        (place.kind, place.keyframes, place.revisit.closest, len(place.edges), round(place.probability, 9))
        for place in found.places
        if place.kind != "incomplete fusion"
    ]
    return {
        "verdict": found.verdict,
        "reason": found.reason,
        "places": dict(Counter(place[0] for place in places)),
        "digest_of_places": hashlib.sha256(repr(places).encode()).hexdigest()[:12],
        "collisions": len(compared.collision_edges),
        "fusion": len(compared.fusion_edges),
        "digest_of_overlaps": hashlib.sha256(
            compared.collision_edges.tobytes() + compared.fusion_edges.tobytes()
        ).hexdigest()[:12],
    }


def _of_parts(found: DiagnosisInParts) -> Row:
    """Figures of an audit in parts alone."""
    bounds = found.compared.scores.bounds
    return {
        "parts": len(found.parts),
        "rounds": found.compared.n_rounds,
        "largest_part": max(part.n_keyframes for part in found.parts),
        "largest_scored": max(part.n_scored for part in found.parts),
        "steps": dict(found.seconds),
        "bounds": [float(f"{each:.2g}") for each in np.quantile(bounds, (0.5, 0.9, 0.99, 1.0)).tolist()],
    }


def report(rows: Sequence[Row]) -> list[str]:
    """A table, and whether both ways agree."""
    lines = [
        "| keyframes | closures | parts | processor s, whole | in parts: main, worker | MB, whole | in parts: main, "
        "worker | collisions | places | the same |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for own in (row for row in rows if row["way"] == "parts"):
        whole = next((row for row in rows if (row["keyframes"], row["way"]) == (own["keyframes"], "whole")), None)
        names = ("verdict", "reason", "digest_of_places", "digest_of_overlaps")
        same = "" if whole is None else "yes" if all(own[name] == whole[name] for name in names) else "no"
        cells = [own["keyframes"], own["closures"], own["parts"]]
        cells += ["" if whole is None else whole["cpu_s"], f"{own['cpu_s']}, {own['worker_cpu_s']}"]
        cells += ["" if whole is None else whole["peak_mb"], f"{own['peak_mb']}, {own['worker_peak_mb']}"]
        cells += [own["collisions"], sum(own["places"].values()), same]
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return lines


if __name__ == "__main__":
    print(json.dumps(row(int(sys.argv[1]), sys.argv[2])))
