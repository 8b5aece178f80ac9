"""All trials: each is a row of a file of JSON lines, appended as soon as it is known, and not run again."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from dask.distributed import Client, LocalCluster, as_completed

from scenarios.diagnosis import trials
from scenarios.diagnosis.trials import Trial


def run(
    path: Path, wanted: Sequence[Trial], data: Path | None, scheduler: str | None, tell: Callable[[str], None]
) -> list[dict[str, Any]]:
    """Run what the file does not hold yet; all rows, in the order of the trials."""
    path.parent.mkdir(parents=True, exist_ok=True)
    done = {_key(row): row for row in rows(path)}
    missing = [trial for trial in wanted if trial not in done]
    tell(f"{len(wanted)} cases, {len(wanted) - len(missing)} of them known")
    if missing:
        cluster = None if scheduler else LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0")
        with Client(scheduler or cluster) as client, path.open("a", encoding="utf-8") as file:
            finished = as_completed(client.map(trials.row, missing, data=data, pure=False), with_results=True)
            for count, (_, row) in enumerate(finished, start=1):
                file.write(json.dumps(row, ensure_ascii=False) + "\n")
                file.flush()
                done[_key(row)] = row
                if count % 50 == 0 or count == len(missing):
                    tell(f"{count} of {len(missing)}")
        if cluster is not None:
            cluster.close()
    return [done[trial] for trial in wanted]


def rows(path: Path) -> Iterator[dict[str, Any]]:
    """Whole rows of the file; a last line that was cut off when a run was killed is cut from it."""
    if not path.is_file():
        return
    text = path.read_text(encoding="utf-8")
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        path.write_text(whole, encoding="utf-8")
    yield from map(json.loads, whole.splitlines())


def _key(row: dict[str, Any]) -> Trial:
    return Trial(row["world"], row["seed"], row["variant"], row["damage"])
