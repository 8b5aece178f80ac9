"""A map of many: audited by the command line in a process of its own, with the numbers for a ranking."""

from __future__ import annotations

import hashlib
import json
import os
import re
import resource
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pgti_gtsam.version import __version__

WAY_POINTS = 200
"""Keyframes, evenly along the track, that the small picture of a map is drawn from."""

MEGABYTE = 2**20

Row = dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class AuditJob:
    """An audit to be run.

    Attributes
    ----------
    map : str
        Path of the file.
    words : tuple of str
        Options of `pgti-gtsam audit`.
    folder : str
        Where JSON and page of the map go.
    limit_s, limit_mb : float
        Time and memory that the process may take.
    """

    map: str
    words: tuple[str, ...]
    folder: str
    limit_s: float
    limit_mb: float

    @property
    def key(self) -> str:
        """Name of the result: the map's own, and a digest of its bytes, the options and this package's version."""
        digest = hashlib.sha256(repr((self.words, __version__)).encode())
        path = Path(self.map)
        for each in sorted(path.rglob("*")) if path.is_dir() else [path]:
            if each.is_file():
                with each.open("rb") as file:
                    while chunk := file.read(MEGABYTE):
                        digest.update(chunk)
        stem = re.sub(r"[^\w.-]+", "_", Path(self.map).name)
        return f"{stem}-{digest.hexdigest()[:12]}"


def audited(job: AuditJob) -> Row:
    """Run an audit; a row holds the result, or in "failed" the reason of failure."""
    stem = Path(job.folder) / job.key
    document, page = stem.with_name(stem.name + ".json"), stem.with_name(stem.name + ".html")
    command = [sys.executable, "-m", "pgti_gtsam.cli.limited", str(round(job.limit_mb * MEGABYTE)), "audit", job.map]
    command += [*job.words, "--quiet", "--json", str(document), "--html", str(page)]

    # a process of its own
    started = time.monotonic()
    row: Row = {"key": job.key, "map": job.map}
    limits = {"limit_s": job.limit_s, "limit_mb": job.limit_mb}
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            encoding="utf-8",
            errors="replace",
            timeout=job.limit_s,
            env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONIOENCODING": "utf-8"},
        )
    except subprocess.TimeoutExpired:
        return row | limits | {"failed": f"no verdict after {job.limit_s:g} s"}

    # what became of it
    row["seconds"] = round(time.monotonic() - started, 3)
    if done.returncode:
        return row | limits | {"failed": _why(done.returncode, done.stderr, job.limit_mb)}
    found = summarised(json.loads(document.read_text(encoding="utf-8")))
    return row | found | {"document": document.name, "page": page.name}


def summarised(document: Mapping[str, Any]) -> Row:
    """The numbers for a ranking from the document of an audit."""
    closures = [closure for closure in document["closures"] if closure["probability"] is not None]
    places, labels = [place["kind"] for place in document["places"]], document["keyframes"]["label"]
    least = min(closures, key=lambda closure: closure["log_odds"], default=None)

    # a picture of the way, to a thousandth of its size
    positions = np.array(document["keyframes"]["position"])[:, :2]
    some = np.unique(np.linspace(0, len(positions) - 1, min(WAY_POINTS, len(positions))).astype(np.int64))
    size = np.ptp(positions, axis=0).max()
    decimals = 3 - int(np.floor(np.log10(size))) if size > 0 else 0
    return {
        "verdict": document["verdict"]["level"],
        "text": document["verdict"]["text"],
        "score": document["summary"]["score"],
        "collision_score": document["summary"]["collisions"]["score"],
        "keyframes": len(labels),
        "collisions": len(document["edges"]["collisions"]),
        "places": {kind: places.count(kind) for kind in dict.fromkeys(places)},
        "false_closures": sum(closure["is_false"] for closure in closures),
        "least_probable": None
        if least is None
        else {"keyframes": [labels[k] for k in least["keyframes"]], "probability": least["probability"]},
        "way": np.round(positions[some], decimals).tolist(),
    }


def limit_memory(n_bytes: int) -> None:
    """Let this process take no more memory than that."""
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    allowed = n_bytes if hard == resource.RLIM_INFINITY else min(n_bytes, hard)
    resource.setrlimit(resource.RLIMIT_AS, (allowed, hard))


def _why(code: int, said: str, limit_mb: float) -> str:
    """A line on the failure."""
    lines = [line.strip() for line in said.splitlines() if line.strip()]
    told = [line.removeprefix("pgti-gtsam: ") for line in lines if line.startswith("pgti-gtsam: ")]
    if told:
        return told[0]
    if code < 0:
        return f"its process was ended by signal {-code}"
    if any("MemoryError" in line or "bad_alloc" in line for line in lines):
        return f"it takes more memory than {limit_mb:g} MB"
    return lines[-1] if lines else f"its process ended with code {code}"
