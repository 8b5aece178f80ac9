"""200 maps of a night, audited by two workers; a worker is killed meanwhile.

198 drives with known damage, a file that is cut off in the middle, and a file without end (a pipe into which nobody
writes). The command line audits all of them on a Dask scheduler and workers started by Dask's commands. After a tenth
of the rows a worker is killed, and a new worker starts. Then the same command is given again.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from dask.distributed import Client
from scipy.stats import spearmanr

from pgti_gtsam.datasets import write_g2o
from scenarios.fleet.drives import RADIUS, damage_of, drive

DASK = Path(sys.executable).with_name("dask")
AUDIT = [sys.executable, "-c", "from pgti_gtsam.cli import main; main()", "audit"]
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
CUT_OFF, ENDLESS = "cut_off.g2o", "endless.g2o"
LIMIT_S, LIMIT_MB = 300, 4000

Tell = Callable[[str], None]


def run(folder: Path, n_maps: int, first_seed: int, tell: Tell) -> dict[str, Any]:
    """Make the maps, audit them twice, and compare the ranking with the damage.

    Parameters
    ----------
    folder : Path
        For maps and pages; maps in the folder are not made again.
    n_maps : int
        Two more than drives.
    first_seed : int
    tell : callable
    """
    seeds = range(first_seed, first_seed + n_maps - 2)
    maps = written(folder / "maps", seeds, tell)
    endless = folder / ENDLESS
    if not endless.exists():
        os.mkfifo(endless)
    rows, out = folder / "out" / "maps.jsonl", folder / "out"
    command = [*AUDIT, maps, endless, "--radius", RADIUS, "--out", out, "--limit-s", LIMIT_S, "--limit-mb", LIMIT_MB]

    # all maps, and a worker killed on the way
    with cluster(folder, n_workers=2) as (address, start, workers):
        started = time.monotonic()
        audit = subprocess.Popen([str(word) for word in [*command, "--scheduler", address]], stdout=subprocess.PIPE)
        while audit.poll() is None and len(_lines(rows)) < n_maps // 10:
            time.sleep(0.2)
        known = len(_lines(rows))
        workers[0].kill()
        tell(f"one of two workers killed after {known} rows")
        start()
        audit.communicate()
        first = time.monotonic() - started, audit.returncode, _lines(rows)
        tell(f"{len(first[2])} rows after {first[0]:.0f} s")

        # the same once more
        started = time.monotonic()
        again = subprocess.run([str(word) for word in [*command, "--scheduler", address]], stdout=subprocess.PIPE)
        second = time.monotonic() - started, again.returncode, _lines(rows)
    ranked = json.loads((out / "maps.json").read_text(encoding="utf-8"))["maps"]
    return {
        "n_maps": n_maps,
        "rows": len(first[2]),
        "seconds": round(first[0], 1),
        "exit_codes": [first[1], second[1]],
        "killed_after_rows": known,
        "rows_added_when_started_again": len(second[2]) - len(first[2]),
        "seconds_when_started_again": round(second[0], 1),
        "failed": [{"map": Path(row["map"]).name, "said": row["failed"]} for row in ranked if "failed" in row],
        "maps": [_compared(place, row) for place, row in enumerate(ranked) if "failed" not in row],
    }


def written(folder: Path, seeds: Sequence[int], tell: Tell) -> Path:
    """Drives as g2o files named by seed, and a file that is cut off.

    Parameters
    ----------
    folder : Path
    seeds : sequence of int
    tell : callable
    """
    folder.mkdir(parents=True, exist_ok=True)
    for count, seed in enumerate(seeds, start=1):
        path = folder / f"drive_{seed:04d}.g2o"
        if not path.exists():
            found = drive(seed)
            write_g2o(found.graph, found.values, path)
        if count % 50 == 0:
            tell(f"{count} of {len(seeds)} maps")
    whole = (folder / f"drive_{seeds[0]:04d}.g2o").read_bytes()
    (folder / CUT_OFF).write_bytes(whole[: 9 * len(whole) // 10])
    return folder


@contextmanager
def cluster(folder: Path, n_workers: int) -> Iterator[tuple[str, Callable[[], None], list[subprocess.Popen[bytes]]]]:
    """A Dask scheduler and workers, started by Dask's commands.

    Parameters
    ----------
    folder : Path
        For the scheduler's file and for the workers.
    n_workers : int

    Yields
    ------
    address : str
    start : callable
        Starts another worker.
    workers : list of Popen
    """
    file = folder / "scheduler.json"
    file.unlink(missing_ok=True)
    workers: list[subprocess.Popen[bytes]] = []
    scheduler = _dask(["scheduler", "--port", "0", "--dashboard-address", ":0", "--scheduler-file", file])

    def start() -> None:
        words = ["worker", "--nthreads", "1", "--no-nanny", "--no-dashboard", "--scheduler-file", file]
        workers.append(_dask([*words, "--local-directory", folder]))

    try:
        while not (file.is_file() and file.read_text(encoding="utf-8")):
            time.sleep(0.1)
        for _ in range(n_workers):
            start()
        address = json.loads(file.read_text(encoding="utf-8"))["address"]
        with Client(address) as client:
            client.wait_for_workers(n_workers)
        yield address, start, workers
    finally:
        for process in (*workers, scheduler):
            process.terminate()
            process.wait()


def _dask(words: Sequence[Any]) -> subprocess.Popen[bytes]:
    """A command of Dask, on a single thread of linear algebra."""
    return subprocess.Popen(
        [str(DASK), *map(str, words)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, **ONE_THREAD},
    )


def _lines(path: Path) -> list[str]:
    return path.read_text(encoding="utf-8").splitlines() if path.is_file() else []


def _compared(place: int, row: dict[str, Any]) -> dict[str, Any]:
    """A map's place in the ranking beside the damage."""
    seed = int(Path(row["map"]).stem.rpartition("_")[2])
    damage = damage_of(seed)
    return {"seed": seed, "place": place, **damage._asdict(), "size": damage.size} | {
        name: row[name] for name in ("verdict", "false_closures", "places", "collisions", "keyframes", "seconds")
    }


def report(found: dict[str, Any]) -> list[str]:
    """The findings, in lines."""
    # verdicts by kind of damage
    maps = found["maps"]
    kinds = {
        "intact": [each for each in maps if not each["size"]],
        "blocks untied": [each for each in maps if each["untied"] and not each["false"]],
        "false closures": [each for each in maps if each["false"] and not each["untied"]],
        "both": [each for each in maps if each["false"] and each["untied"]],
    }
    lines = ["| damage | maps | consistent | incomplete | undecided | inconsistent |", "|---|---|---|---|---|---|"]
    for name, own in kinds.items():
        verdicts = [each["verdict"] for each in own]
        counts = [str(verdicts.count(v)) for v in ("consistent", "incomplete", "undecided", "inconsistent")]
        lines.append(f"| {name} | {len(own)} | {' | '.join(counts)} |")

    # the ranking, and how the run went
    exact = sum(each["false_closures"] == each["false"] for each in maps)
    return [
        *lines,
        "",
        f"Spearman's ρ of ranking and damage: {spearman(maps):.3f} of all, "
        f"{spearman([each for each in maps if each['size']]):.3f} of those with damage.",
        f"As many closures called false as there are: {exact} of {len(maps)}.",
        f"{found['rows']} rows of {found['n_maps']} files in {found['seconds']} s, a worker killed after "
        f"{found['killed_after_rows']}; started again: {found['rows_added_when_started_again']} rows more, "
        f"{found['seconds_when_started_again']} s.",
        *(f"{each['map']}: {each['said']}" for each in found["failed"]),
    ]


def spearman(maps: Sequence[dict[str, Any]]) -> float:
    """Spearman's ρ of the place in the ranking, the last place least, and the size of the damage."""
    return float(spearmanr([-each["place"] for each in maps], [each["size"] for each in maps]).statistic)
