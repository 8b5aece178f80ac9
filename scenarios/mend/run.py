"""All experiments with their JSON file: known rows are not run again."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from pgti_gtsam import outputs
from scenarios.mend import aces, fits, limits, logs, worlds

Found = dict[str, list[dict[str, Any]]]


def run(data: Path | None, seeds: Sequence[int], out: Path, tell: Callable[[str], None]) -> Found:
    """Run the experiments missing in `out`, and write each row as soon as known.

    Parameters
    ----------
    data : Path or None
        Folder of all data; worlds only without.
    seeds : sequence of int
        Of thinned loops and of drives; logs without loops, and intact logs, are run once.
    """
    found: Found = json.loads(out.read_text(encoding="utf-8")) if out.is_file() else {}

    def keep(table: str, known: dict[str, Any], make: Callable[[], dict[str, Any]]) -> None:
        rows = found.setdefault(table, [])
        if any(all(row.get(key) == value for key, value in known.items()) for row in rows):
            return
        rows.append({**known, **make()})
        tell(f"{table}: {known}")
        outputs.write_text(out, json.dumps(found, indent=1) + "\n")

    # every experiment
    for log, kind in [(log, kind) for kind in logs.KINDS for log in logs.LOGS] if data is not None else []:
        for seed in seeds if kind.startswith("a tenth") else seeds[:1]:
            path = Path(data or "") / "scan_pose_graphs" / f"{log}.log"
            keep("logs", {"log": log, "kind": kind, "seed": seed}, lambda p=path, k=kind, s=seed: logs.row(p, k, s))
    if data is not None:
        for log in logs.LOGS:
            path = Path(data) / "scan_pose_graphs" / f"{log}.log"
            keep("limits", {"log": log}, lambda p=path: limits.row(p))
        keep("aces", {"log": "aces"}, lambda: aces.row(Path(data) / "radish_aces" / "aces.clf.bz2"))
    for world in worlds.WORLDS:
        for seed in seeds:
            keep("worlds", {"world": world, "seed": seed}, lambda w=world, s=seed: worlds.row(w, s))
    for use, names in (("chosen on", fits.CHOSEN), ("checked on", fits.CHECKED)):
        for name in names:
            if data is not None or " " in name:
                keep("fits", {"use": use, "name": name}, lambda n=name: fits.row(n, data))
    return found
