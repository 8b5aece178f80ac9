"""Damaged and odd files of every format: read, audited and gated, or refused in one line; never a crash."""

import os
import tempfile
import warnings
from pathlib import Path

import pytest
from fuzz_hour import fuzz, tried, unpacked
from fuzzing import damaged, maps, odd_maps, put
from hypothesis import HealthCheck, given, settings

import pgti_gtsam as pgti
from pgti_gtsam import datasets
from pgti_gtsam.errors import PgtiError

SEEDS = (Path(__file__).parent / "fuzz_seeds.jsonl").read_text().splitlines()
PROBED = {"archive"}  # formats that a process of its own reads first, a second each
QUICK = sorted(set(maps()) - PROBED)
LONG_S = float(os.environ.get("PGTI_FUZZ_SECONDS", "3600"))
relaxed = settings(derandomize=True, deadline=None, suppress_health_check=list(HealthCheck))


def read(drawn, folder):
    """The dataset, or None where it is refused in one line."""
    files, name, values = drawn
    put(files, folder)
    try:
        return datasets.read(folder / name, None if values is None else folder / values)
    except PgtiError as error:
        message = str(error)
    assert "\n" not in message
    assert len(message) < 700 + len(str(folder))
    return None


def judge(dataset, radius=1.0):
    """Audit and gate a dataset; refusals are welcome."""
    radii = dataset.radii or radius
    message = ""
    for call in (
        lambda: pgti.diagnose(dataset.graph, dataset.values, radii=radii, closures=dataset.closures),
        lambda: pgti.gate_graph(dataset.graph, dataset.values, radii, closures=dataset.closures),
    ):
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RuntimeWarning)
                call()
        except PgtiError as error:
            message = str(error)
        assert "\n" not in message


@settings(relaxed, max_examples=250)
@given(damaged(QUICK))
def test_damaged_files_are_read_or_refused(drawn):
    with tempfile.TemporaryDirectory() as folder:
        read(drawn, Path(folder))


@settings(relaxed, max_examples=2)
@given(damaged(PROBED))
def test_damaged_archives_are_read_or_refused(drawn):
    with tempfile.TemporaryDirectory() as folder:
        read(drawn, Path(folder))


@pytest.mark.parametrize("line", SEEDS)
def test_what_the_hour_of_fuzz_kept(line):
    """The first map of every way to be refused or judged, and those that a command once failed on."""
    case, (step, kind) = unpacked(line)
    told, text = tried(*case)[step]
    assert (told, "\n" in text) == (kind, False)


@settings(relaxed, max_examples=20)
@given(odd_maps())
def test_odd_maps_are_judged_or_refused(drawn):
    judge_text(*drawn)


def judge_text(text, radius):
    with tempfile.TemporaryDirectory() as folder:
        found = read(({"odd.g2o": text.encode()}, "odd.g2o", None), Path(folder))
    if found is not None:
        judge(found, radius)


@pytest.mark.slow
def test_an_hour_of_damaged_and_odd_files(tmp_path):
    """``PGTI_FUZZ_SECONDS`` makes it shorter or longer."""
    fuzz(LONG_S, 0, tmp_path)
    assert not (tmp_path / "findings.jsonl").exists()
