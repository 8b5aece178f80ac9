"""Fuzz every reader and what follows it for a time: `python tests/fuzz_hour.py --seconds 3600 --out FOLDER`.

A child reads each damaged or odd map, and runs `audit`, `gate`, `replay` and `diffusion` on what is read. This process
draws the maps, waits 30 s of the child's processor time for each, and restarts a child that hangs or dies. FOLDER gets
``findings.jsonl`` (tracebacks, hangs, deaths, needs of more than 2 GB), ``corpus.jsonl`` (the first map of every way to
be refused or judged), and ``counts.json``.
"""

import argparse
import base64
import collections
import contextlib
import io
import json
import logging
import multiprocessing
import os
import re
import resource
import sys
import tempfile
import time
import traceback
import warnings
import zlib
from pathlib import Path

from fuzzing import damaged, odd_maps, put
from hypothesis import HealthCheck, Phase, given, seed, settings

from pgti_gtsam import cli, datasets
from pgti_gtsam.errors import PgtiError

LIMIT_S, LIMIT_BYTES = 30.0, 2 << 30
OUTPUTS = {"audit": "--json a.json", "gate": "--json g.json --out g.g2o", "replay": "--json r.jsonl", "diffusion": ""}
TOO_LARGE = "the memory does not suffice"


def tried(drawn, radius):
    """What reading does, and each command: outcomes by name, each a kind and a text."""
    files, name, values = drawn
    with tempfile.TemporaryDirectory() as scratch, contextlib.chdir(scratch):
        folder = Path("map")
        put(files, folder)
        path, given_values = folder / name, None if values is None else folder / values
        found = {"read": outcome(lambda: datasets.read(path, given_values))}
        if found["read"][0] != "done":
            return found
        more = [] if given_values is None else ["--values", str(given_values)]
        for command, words in OUTPUTS.items():
            argv = [command, str(path), *more, *words.split()]
            argv += [] if command == "diffusion" else ["--radius", repr(radius)]
            found[command] = outcome(lambda argv=argv: commanded(argv))
        return found


def unpacked(line):
    """A map and a radius of the corpus: what `tried` takes, and the line's own outcome."""
    kept = json.loads(line)
    files = {place: zlib.decompress(base64.b85decode(data)) for place, data in kept["files"].items()}
    return ((files, kept["read"], kept["values"]), kept["radius"]), (kept["step"], kept["kind"])


def commanded(argv):
    """Run the command line in this process; raises what it lets through."""
    sys.argv = ["pgti-gtsam", *argv]
    told = io.StringIO()
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(told):
            cli.main()
    except SystemExit as stop:
        message = told.getvalue().strip()
        if stop.code in (0, None, 1):
            return
        if stop.code != 2 or not message.startswith("pgti-gtsam: "):
            raise RuntimeError(f"exit code {stop.code}: {message}") from None
        raise PgtiError(message.split("\n")[0]) from None


def outcome(call):
    """A kind (done, refused, memory, crash) and the message or traceback."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            call()
    except PgtiError as error:
        message = str(error)
        wrong = "\n" in message or not message
        return "crash" if wrong else "memory" if TOO_LARGE in message else "refused", message
    except MemoryError:
        return "memory", traceback.format_exc()
    except Exception:  # noqa: BLE001  what is looked for
        return "crash", traceback.format_exc()
    return "done", ""


def serve(pipe):
    """Answer cases until the other end closes."""
    logging.disable(logging.CRITICAL)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + LIMIT_BYTES, used + LIMIT_BYTES))
    while True:
        try:
            case = pipe.recv()
        except EOFError:
            return
        pipe.send(tried(*case))


class Child:
    """A process that tries cases, replaced where it hangs or dies."""

    def __init__(self):
        self.start()

    def start(self):
        context = multiprocessing.get_context("fork")
        self.pipe, far = context.Pipe()
        self.process = context.Process(target=serve, args=(far,), daemon=True)
        self.process.start()
        far.close()

    def busy_s(self):
        """Processor time that the child has used."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def ask(self, case):
        began = self.busy_s()
        self.pipe.send(case)
        try:
            while not self.pipe.poll(1.0):
                if self.busy_s() - began > LIMIT_S:
                    break
            else:
                return self.pipe.recv()
            found = {"read": ("hang", f"no answer in {LIMIT_S:.0f} s of processor time")}
        except (EOFError, OSError):
            self.process.join(5)
            found = {"read": ("death", f"exit code {self.process.exitcode}")}
        self.process.kill()
        self.process.join()
        self.start()
        return found


def shape(text):
    """A message without what differs from file to file."""
    return re.sub(r"\S*/\S*|\d[\d.e+-]*|'[^']*'|\"[^\"]*\"|[^\x00-\x7f]+", "#", text)[:100]


class Notes:
    """Counts, findings and corpus of a run, written as they come."""

    def __init__(self, folder):
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.counts, self.seen = folder, collections.Counter(), set()
        self.slowest = self.busy = 0.0
        self.started = time.monotonic()

    def add(self, case, found, seconds):
        self.slowest, self.busy = max(self.slowest, seconds), self.busy + seconds
        for step, (kind, text) in found.items():
            self.counts[f"{step} {kind}"] += 1
            if kind in ("crash", "hang", "death", "memory"):
                self.put("findings.jsonl", case, step, kind, text)
            elif (step, kind, shape(text)) not in self.seen:
                self.seen.add((step, kind, shape(text)))
                self.put("corpus.jsonl", case, step, kind, text)

    def put(self, name, case, step, kind, text):
        (files, read, values), radius = case
        packed = {place: base64.b85encode(zlib.compress(data, 9)).decode() for place, data in files.items()}
        line = {"step": step, "kind": kind, "text": text, "radius": radius, "read": read, "values": values}
        with (self.folder / name).open("a") as file:
            file.write(json.dumps(line | {"files": packed}) + "\n")

    def write(self):
        written = {"seconds": round(time.monotonic() - self.started, 1), "slowest_s": round(self.slowest, 2)}
        written["processor_s"] = round(self.busy, 1)
        written["shapes"] = len(self.seen)
        text = json.dumps(written | {"counts": dict(sorted(self.counts.items()))}, indent=1)
        (self.folder / "counts.json").write_text(text + "\n")


def main():
    """Fuzz for a time."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=3600.0)
    parser.add_argument("--seed", type=int, default=0, help="of the first round")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    fuzz(options.seconds, options.seed, options.out)
    sys.stdout.write((options.out / "counts.json").read_text())


def fuzz(seconds, first, folder):
    """Rounds of cases by seeds from the first on, until the time is over."""
    notes, child, end = Notes(folder), Child(), time.monotonic() + seconds
    number = first
    while time.monotonic() < end:
        one_round(number, child, notes)
        number += 1


def one_round(number, child, notes):
    """150 damaged files, and 50 odd maps."""
    drawing = settings(deadline=None, database=None, phases=[Phase.generate], suppress_health_check=list(HealthCheck))

    def tell(case):
        before = child.busy_s()
        found = child.ask(case)
        notes.add(case, found, max(0.0, child.busy_s() - before))
        notes.write()

    @seed(number)
    @settings(drawing, max_examples=150)
    @given(damaged())
    def files(drawn):
        tell((drawn, 1.0))

    @seed(number)
    @settings(drawing, max_examples=50)
    @given(odd_maps())
    def numbers(drawn):
        text, radius = drawn
        tell((({"odd.g2o": text.encode()}, "odd.g2o", None), radius))

    files()
    numbers()


if __name__ == "__main__":
    main()
