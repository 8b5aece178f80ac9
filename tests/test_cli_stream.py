"""`pgti-gtsam gate --stream` and `--socket` as processes: killed and resumed, two clients, a pipe that breaks."""

import json
import shutil
import socket
import subprocess
import sys
import time
from pathlib import Path

import gtsam
import pytest

from pgti_gtsam import datasets
from pgti_gtsam.datasets.chain import between_factors
from pgti_gtsam.gate import GatedISAM2, LoopClosureGate
from pgti_gtsam.stream import Session

ROOT = Path(__file__).parents[1]
KITTI = ROOT.parent / "shared" / "data" / "kitti_robustslam"
GATE = [sys.executable, "-c", "from pgti_gtsam.cli import main; main()", "gate"]
RADIUS_M = 4.0
needs_data = pytest.mark.skipif(not KITTI.is_dir(), reason=f"{KITTI} is not here")


def started(*words, **pipes):
    return subprocess.Popen([*GATE, *map(str, words)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=ROOT, **pipes)


def lap(n=44, false=20):
    """Lines of a lap around a square and one more, with a true and a false closure."""
    turn = 1.5707963267948966
    lines = [
        f"EDGE_SE2 {k} {k + 1} 1 0 {turn if (k + 1) % (n // 4) == 0 else 0} 400 0 0 400 0 10000" for k in range(n + 8)
    ]
    return [
        *lines,
        f"EDGE_SE2 {false} {n + 5} 0 0 0 400 0 0 400 0 10000",
        f"EDGE_SE2 3 {n + 3} 0 0 0 400 0 0 400 0 10000",
    ]


def answered(lines):
    session = Session.started(LoopClosureGate(), RADIUS_M)
    return [answer for line in lines for answer in session.answers(line)]


def in_time_order(name):
    """Every fifth frame of a drive: odometry, and closures as a detector reported them, in the order of time."""
    dataset = datasets.subsample(datasets.read(KITTI / name), 5)
    betweens = between_factors(dataset.graph)
    return sorted(betweens, key=lambda between: (between.ends[1], between.ends[0] + 1 != between.ends[1], between.slot))


def line_of(between):
    measured = between.factor.measured()
    information = between.factor.noiseModel().information()
    upper = [information[i, j] for i in range(3) for j in range(i, 3)]
    numbers = [measured.x(), measured.y(), measured.theta(), *upper]
    return f"EDGE_SE2 {between.first} {between.second} {' '.join(repr(float(number)) for number in numbers)}"


def verdicts_of_the_smoother(betweens):
    isam, found = GatedISAM2(radii=RADIUS_M), []
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    factors.push_back(gtsam.PriorFactorPose2(0, gtsam.Pose2(), gtsam.noiseModel.Isotropic.Sigma(3, 1e-3)))
    values.insert(0, gtsam.Pose2())
    isam.update(factors, values)
    there, previous = {0}, 0
    for between in betweens:
        before, key = between.ends
        if key in there:
            update = isam.update(closures=[between.factor])
            found += [(between.first, between.second, decision.verdict) for decision in update.decisions]
            found += [(number, decision.verdict) for number, decision in update.changed.items()]
            continue
        assert before == previous
        factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        factors.push_back(between.factor)
        values.insert(key, isam.calculateEstimatePose2(before).compose(between.step_from(before)))
        isam.update(factors, values)
        there, previous = there | {key}, key
    return found


def verdicts(answers):
    return [
        (answer["id"], answer["verdict"]) if answer["changed"] else (*answer["keys"], answer["verdict"])
        for answer in answers
    ]


@needs_data
@pytest.mark.parametrize(
    "name", ["06/kitti_06_alpha_0.15.g2o", pytest.param("07/kitti_07_alpha_0.25.g2o", marks=pytest.mark.slow)]
)
def test_kitti_line_by_line_killed_and_resumed_gives_the_verdicts_of_the_smoother(name, tmp_path):
    betweens = in_time_order(name)
    lines, expected = [line_of(between) for between in betweens], verdicts_of_the_smoother(betweens)
    assert {verdict for *_, verdict in expected} >= {"accepted", "rejected"}

    # killed while it reads
    state, half = tmp_path / "state.json", len(lines) * 3 // 4
    first = started("--stream", "--radius", RADIUS_M, "--state", state)
    first.stdin.write("".join(line + "\n" for line in lines[:half]).encode())
    first.stdin.flush()
    answers = [json.loads(first.stdout.readline()) for _ in range(10)]
    first.kill()
    first.wait()
    answers += [json.loads(line) for line in first.stdout.read().splitlines()]

    # the rest, from where it says that it goes on
    second = started("--stream", "--state", state)
    resumed = json.loads(second.stdout.readline())["resumed"]["line"]
    assert len(answers) <= resumed <= half
    second.stdin.write("".join(line + "\n" for line in lines[resumed:]).encode())
    second.stdin.close()
    later = [json.loads(line) for line in second.stdout.read().splitlines()]
    assert second.wait(timeout=60) == 0
    again = [answer for answer in later if answer.pop("again", False)]
    assert again[: len(answers)] == answers
    assert verdicts(later) == expected
    assert [path.name for path in tmp_path.iterdir()] == ["state.json"]


def test_two_clients_of_a_socket_have_a_map_each_and_so_has_one_in_another_language(run, tmp_path):
    path, one, other = tmp_path / "gate.sock", lap(), lap(64, 30)
    with socket.socket(socket.AF_UNIX) as left:  # by a server that was killed
        left.bind(str(path))
    server = started("--socket", path, "--radius", RADIUS_M)
    try:
        clients = [connected(path, server), connected(path, server)]
        for pair in zip(one, other, strict=False):
            for client, line in zip(clients, pair, strict=True):
                client.sendall(line.encode() + b"\n")
        clients[1].sendall("".join(line + "\n" for line in other[len(one) :]).encode())
        told = []
        for client in clients:
            client.shutdown(socket.SHUT_WR)
            told.append([json.loads(line) for line in client.makefile()])
        assert told == [answered(one), answered(other)]
        assert [answer["accepted"] for answer in told[0]] == [False, True]
        in_another_language(path, tmp_path, one)
        code, _, err = run("gate", "--socket", path)
        assert (code, "which another one serves" in err) == (2, True)
    finally:
        server.terminate()
        assert server.wait(timeout=20) == 0
    assert not path.exists()


def test_a_client_that_says_its_name_goes_on_where_it_was(tmp_path):
    path, lines = tmp_path / "gate.sock", lap()
    name, half = b'{"client": "robot-1"}\n', len(lines) - 1
    text = ["".join(line + "\n" for line in part).encode() for part in (lines[:half], lines[half:])]
    server = started("--socket", path, "--radius", RADIUS_M, "--state", tmp_path / "maps")
    try:
        first = connected(path, server)
        first.sendall(name + text[0])
        told = first.makefile()
        answers = [json.loads(told.readline())]

        # the name is taken as long as the first is there
        for client, said in ((name, "another process keeps"), (b'{"client": "../x"}\n', "a client's name")):
            other = connected(path, server)
            other.sendall(client)
            (answer,) = map(json.loads, other.makefile())
            assert (answer["line"], said in answer["error"]) == (0, True)

        # gone, and back
        told.close()
        first.close()
        again = {}
        while "resumed" not in again:  # until the process of the first has written its map
            second = connected(path, server)
            second.sendall(name)
            answer = second.makefile()
            again = json.loads(answer.readline())
        assert again["resumed"]["line"] == half
        second.sendall(text[1])
        second.shutdown(socket.SHUT_WR)
        answers += [json.loads(line) for line in answer]
        for own, whole in zip(answers, answered(lines), strict=True):
            assert (own["line"], own["verdict"]) == (whole["line"], whole["verdict"])
            assert own["log_odds"] == pytest.approx(whole["log_odds"], rel=1e-6)
    finally:
        server.terminate()
        assert server.wait(timeout=20) == 0
    assert [each.name for each in (tmp_path / "maps").iterdir()] == ["robot-1.json"]


def test_a_server_without_states_keeps_no_maps(tmp_path):
    path = tmp_path / "gate.sock"
    server = started("--socket", path)
    try:
        client = connected(path, server)
        client.sendall(b'{"client": "robot-1"}\n')
        (answer,) = map(json.loads, client.makefile())
        assert "keeps no maps" in answer["error"]
    finally:
        server.terminate()
        assert server.wait(timeout=20) == 0


def test_a_state_belongs_to_one_process(run, tmp_path):
    state = tmp_path / "state.json"
    first = started("--stream", "--radius", RADIUS_M, "--state", state)
    first.stdin.write(b"EDGE_SE2 0 1 x\n")
    first.stdin.flush()
    assert "error" in json.loads(first.stdout.readline())
    code, out, err = run("gate", "--stream", "--state", state)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "another process keeps" in err
    first.kill()
    first.wait()
    last = started("--stream", "--state", state)
    last.stdin.close()
    assert json.loads(last.stdout.readline())["resumed"]["line"] == 1
    assert last.wait(timeout=60) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["state.json"]


def connected(path, server):
    """A client, as soon as the server is there."""
    for _ in range(600):
        client = socket.socket(socket.AF_UNIX)
        try:
            client.connect(str(path))
        except OSError:
            client.close()
            assert server.poll() is None
            time.sleep(0.05)
        else:
            client.settimeout(60)
            return client
    raise AssertionError("the server does not start")


def in_another_language(path, folder, lines):
    """The C++ client, where there is a compiler."""
    source, compiler = ROOT / "docs" / "gate_client.cpp", shutil.which("c++")
    assert source.read_text(encoding="utf-8").count("\n") <= 80
    if compiler is None:
        return
    command = [compiler, "-std=c++17", "-Wall", "-Wextra", "-Werror", "-pthread", str(source), "-o", folder / "client"]
    subprocess.run(command, check=True)
    text = "".join(line + "\n" for line in lines)
    done = subprocess.run([folder / "client", path], input=text, capture_output=True, text=True, timeout=60)
    assert done.stdout.splitlines() == [f"{len(lines) - 1} rejected", f"{len(lines)} accepted"]
    assert subprocess.run([folder / "client", folder / "none"], capture_output=True).returncode == 1


def test_a_pipe_that_breaks_ends_a_stream_quietly():
    broken = started("--stream", stderr=subprocess.PIPE)
    broken.stdin.write(b"EDGE_SE2 0 1 x 0 0\n")
    broken.stdin.flush()
    assert "error" in json.loads(broken.stdout.readline())  # answered while the input is open
    broken.stdout.close()
    broken.stdin.write(b"EDGE_SE2 0 1 x 0 0\n")
    broken.stdin.flush()
    assert broken.wait(timeout=60) == 141
    assert broken.stderr.read() == b""
    broken.stderr.close()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["map.g2o", "--stream"], "expected a stream alone, got a FILE"),
        (["--stream", "--out", "x.g2o"], "got --out"),
        (["--socket", "s", "--stream"], "expected --stream or --socket"),
        (["--socket", "s", "--state", __file__], "--state with --socket as a folder"),
        (["map.g2o", "--state", "t"], "expected --state with --stream"),
        ([], "expected a FILE, or --stream"),
        (["--socket", __file__], "expected the name of a new socket"),
    ],
)
def test_what_does_not_go_with_a_stream_is_refused(run, words, said):
    code, _, err = run("gate", *words)
    assert code == 2
    assert said in err
