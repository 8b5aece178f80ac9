"""Gates that run at once, in threads and in processes, answer as each does alone."""

import multiprocessing
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import gtsam
import pytest
from test_units import laps

import pgti_gtsam as pgti
from pgti_gtsam.report.decisions import evidence

RADII = [0.5 + 0.5 * k for k in range(10)]  # m
FORK = multiprocessing.get_context("fork")


def answers(radius):
    """Evidence on every closure of a map, and the errors of the gated graph and of a gated smoother's estimate."""
    graph, values = laps(spatial=False)
    gated = pgti.gate_graph(graph, values, radius)
    smoother = pgti.GatedISAM2(radii=radius)
    closures = [graph.at(slot) for slot in gated.decisions]
    for slot in gated.decisions:
        graph.remove(slot)
    graph.addPriorPose2(0, values.atPose2(0), gtsam.noiseModel.Unit.Create(3))
    decisions = smoother.update(graph, values, closures).decisions
    told = [evidence(decision) for decision in (*gated.decisions.values(), *decisions)]
    return told, gated.graph.error(gated.values), gated.graph.error(smoother.estimate())


@pytest.fixture(scope="module")
def alone():
    return [answers(radius) for radius in RADII]


def test_answers_differ_from_gate_to_gate(alone):
    assert len({repr(each) for each in alone}) == len(RADII)


@pytest.mark.parametrize(
    "pool",
    [lambda: ThreadPoolExecutor(10), lambda: ProcessPoolExecutor(10, mp_context=FORK)],
    ids=["threads", "processes"],
)
def test_ten_at_once_answer_as_each_alone(alone, pool):
    with pool() as workers:
        assert list(workers.map(answers, RADII)) == alone
