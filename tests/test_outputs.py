"""Files are written whole or not at all: full disks, signals, kills, links, devices, pipes."""

import multiprocessing
import os
import resource
import signal
import stat
import subprocess
import sys
import threading
import time

import pytest

from pgti_gtsam import outputs
from pgti_gtsam.errors import OutputError

OLD, NEW = b"old" * 1000, b"new" * 2_000_000


def put(*paths):
    """Replace files together."""
    with outputs.together():
        for path in paths:
            outputs.write_bytes(path, NEW)


def put_and_fail(path):
    with outputs.together():
        outputs.write_bytes(path, NEW)
        raise ZeroDivisionError


def parts(folder):
    return list(folder.glob(".pgti-*"))


@pytest.fixture
def two(tmp_path):
    paths = [tmp_path / "map.json", tmp_path / "map.html"]
    for path in paths:
        path.write_bytes(OLD)
    return paths


def test_what_is_written_is_there_and_nothing_else(tmp_path):
    outputs.write_text(tmp_path / "a", "Λ\n")
    with outputs.drawn(tmp_path / "b.png") as part:
        assert part.suffix == ".png"
        part.write_bytes(b"picture")
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {
        "a": "Λ\n".encode(),
        "b.png": b"picture",
    }


def test_permissions_stay_and_new_files_have_those_of_the_process(tmp_path):
    old, new = tmp_path / "old", tmp_path / "new"
    old.write_bytes(OLD)
    old.chmod(0o640)
    before = os.umask(0o027)
    try:
        outputs.write_bytes(old, NEW)
        outputs.write_bytes(new, NEW)
    finally:
        os.umask(before)
    assert [stat.S_IMODE(path.stat().st_mode) for path in (old, new)] == [0o640, 0o640]


@pytest.mark.parametrize("exists", [True, False])
def test_symbolic_links_are_followed_and_stay(tmp_path, exists):
    target, link = tmp_path / "target", tmp_path / "link"
    if exists:
        target.write_bytes(OLD)
    link.symlink_to(target.name)
    outputs.write_bytes(link, NEW)
    assert link.is_symlink()
    assert target.read_bytes() == NEW


def test_the_longest_name_is_written(tmp_path):
    path = tmp_path / ("n" * 255)
    outputs.write_bytes(path, NEW)
    assert path.read_bytes() == NEW


@pytest.mark.parametrize("name", ["missing/file", "loop", "n" * 256, "folder"])
def test_what_cannot_be_written_is_named(tmp_path, name):
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "folder").mkdir()
    with pytest.raises(OutputError, match=r"cannot be written: .*; nothing was written"):
        outputs.write_bytes(tmp_path / name, NEW)
    assert not parts(tmp_path)


def test_nothing_appears_where_one_of_several_fails(tmp_path, two):
    with pytest.raises(OutputError, match="nothing was written"):
        put(two[0], tmp_path / "missing" / "file")
    with pytest.raises(ZeroDivisionError):
        put_and_fail(two[0])
    assert [path.read_bytes() for path in two] == [OLD, OLD]
    assert not parts(tmp_path)


def test_files_that_appeared_before_a_rename_failed_are_named(two, monkeypatch):
    replace, calls = os.replace, []

    def fails_second(part, target):
        calls.append(target)
        if len(calls) == 2:
            raise PermissionError(1, "Operation not permitted")
        replace(part, target)

    monkeypatch.setattr(os, "replace", fails_second)
    with pytest.raises(OutputError) as error:
        put(*two)
    assert str(error.value) == f"{two[1]} cannot be written: Operation not permitted; written are {two[0]} alone"
    assert [path.read_bytes() for path in two] == [NEW, OLD]
    assert not parts(two[0].parent)


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full")
def test_a_full_device_is_named_before_any_file_appears(two):
    with pytest.raises(OutputError, match="/dev/full cannot be written: No space left on device"):
        put(two[0], "/dev/full")
    assert two[0].read_bytes() == OLD


def test_a_pipe_is_written_directly(tmp_path):
    path, found = tmp_path / "pipe", []
    os.mkfifo(path)
    reader = threading.Thread(target=lambda: found.append(path.read_bytes()))
    reader.start()
    outputs.write_bytes(path, NEW)
    reader.join()
    assert found == [NEW]
    assert path.is_fifo()


def test_standard_output_into_a_file_keeps_what_is_printed(tmp_path):
    path = tmp_path / "both"
    script = "import outputs_of; print('before'); outputs_of.write_text('/dev/stdout', 'it\\n'); print('after')"
    script = script.replace("import outputs_of", "from pgti_gtsam import outputs as outputs_of")
    with path.open("wb") as file:
        subprocess.run([sys.executable, "-c", script], stdout=file, check=True)
    assert path.read_text() == "before\nit\nafter\n"


@pytest.mark.parametrize("kept", [0, 4096, 5_999_999])
def test_a_disk_that_fills_up_loses_nothing(two, kept):
    """RLIMIT_FSIZE fails writes beyond a size, as a full disk does."""
    limits, handler = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (kept, limits[1]))
    try:
        with pytest.raises(OutputError, match="nothing was written"):
            put(*two)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)
    assert [path.read_bytes() for path in two] == [OLD, OLD]
    assert not parts(two[0].parent)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux" or os.geteuid() != 0, reason="only root mounts a disk")
def test_full_disks_lose_nothing(tmp_path):
    """A disk of 16 MB that is filled until less than two files of 6 MB fit, at 20 levels."""
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=16m", "tmpfs", tmp_path], check=True)
    try:
        paths = [tmp_path / "map.json", tmp_path / "map.html"]
        for level in range(20):
            for path in paths:
                path.write_bytes(OLD)
            disk = os.statvfs(tmp_path)
            filled = disk.f_bavail * disk.f_bsize - int(2 * len(NEW) * level / 20)
            (tmp_path / "filled").write_bytes(bytes(filled))
            with pytest.raises(OutputError, match="No space left on device; nothing was written"):
                put(*paths)
            assert [path.read_bytes() for path in paths] == [OLD, OLD]
            assert not parts(tmp_path)
            (tmp_path / "filled").unlink()
    finally:
        subprocess.run(["umount", tmp_path], check=True)


def replace_for_ever(paths, ready):
    """Replace two large files together, again and again."""
    sys.stderr = open(os.devnull, "w")  # noqa: SIM115  where an interrupt leaves its traceback
    signal.signal(signal.SIGINT, signal.default_int_handler)  # whatever an earlier test has made of these
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    ready.set()
    while True:
        put(*paths)


def killed(paths, number, delay):
    """Send a signal to a process so long after its first write began; its exit code."""
    fork = multiprocessing.get_context("fork")
    ready = fork.Event()
    process = fork.Process(target=replace_for_ever, args=(paths, ready))
    process.start()
    ready.wait()
    time.sleep(delay)
    os.kill(process.pid, number)
    process.join(timeout=60)
    still_there = process.is_alive()
    process.kill()
    assert not still_there
    return process.exitcode


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
@pytest.mark.parametrize("kills", [8, pytest.param(200, marks=pytest.mark.slow)])
def test_a_kill_at_the_write_leaves_whole_files(two, number, kills):
    for kill in range(kills):
        for path in two:
            path.write_bytes(OLD)
        assert killed(two, number, 0.03 * kill / kills) != 0
        found = [path.read_bytes() for path in two]
        assert all(data in (OLD, NEW) for data in found)
        if number != signal.SIGKILL:
            assert found[0] == found[1]
            assert not parts(two[0].parent)
