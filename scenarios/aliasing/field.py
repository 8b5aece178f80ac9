"""The field's protocol: false closures mixed into the true closures of standard graphs (Sünderhauf's Vertigo, ICRA
2013).

A false closure joins two keyframes that the clean optimum has more than 10 m apart, with the relative pose of a true
one; one that passes χ² there is none. Truth is the optimum of the published graph, if χ² bears that out. Free radii,
These files hold no free radii: twice the median step is assumed. Whether a false closure brings free space into
contact is not told: all count as contacts.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy import stats

from pgti_gtsam import datasets
from pgti_gtsam.datasets.chain import poses_of
from pgti_gtsam.errors import InvalidOptionError
from pgti_gtsam.factor_graphs import factors_of, graph_of
from scenarios.problem import Problem, alone, between

APART_M = 10.0
RADIUS_STEPS = 2.0

BORNE_OUT = 0.999
"""Quantile of χ² up to which an optimum may be the truth. Levenberg-Marquardt from the vertices of MIT.g2o ends at 770
with 60 degrees of freedom, where the quantile is 100; closure by closure it ends at 41. From the vertices of
torus3D.g2o it ends at 59 907 with 24 294 degrees of freedom, where the quantile is 24 981; from the chordal start at
24 235."""

GROUP = 10
"""Consecutive keyframes whose false closures say the same."""

LOCAL = 20
"""Keyframes beyond the first that lies far enough, among which a local one ends."""

KINDS = ("random", "local", "grouped", "random-grouped")
"""Any two keyframes; two close in time; groups of `GROUP` of these; groups of any."""


def problem(path: Path, seed: int, share: float, kind: str = "random") -> Problem:
    """A graph with outliers, in time order.

    Parameters
    ----------
    path : Path
        g2o file of Pose2 or Pose3 keyframes.
    seed : int
    share : float
        False closures per true closure.
    kind : str
        Of `KINDS`.
    """
    # the published graph
    if not path.is_file():
        raise InvalidOptionError(
            f"expected a standard graph, got no file {path}; --data names the folder of the graphs"
        )
    dataset = datasets.read(path)
    random, start = np.random.default_rng(seed), poses_of(dataset.values)[0]
    planar = isinstance(start, gtsam.Pose2)
    prior = (gtsam.PriorFactorPose2 if planar else gtsam.PriorFactorPose3)(
        0, start, gtsam.noiseModel.Isotropic.Sigma(3 if planar else 6, 1e-3)
    )

    # true closures, by the optimum, and false closures
    slots = datasets.closure_slots(dataset)
    steps = [dataset.graph.at(slot) for slot in range(dataset.graph.size()) if slot not in set(slots)]
    odometry, inliers = graph_of([prior, *steps]), [dataset.graph.at(slot) for slot in slots]
    truth = true_poses(odometry, inliers, dataset.values, datasets.chain_odometry(dataset))
    drawn, n_outliers = _outliers(truth, inliers, kind, random), max(1, round(share * len(inliers)))
    factors = [*inliers, *(next(drawn) for _ in range(n_outliers))]

    # in time order
    order = sorted(range(len(factors)), key=lambda k: (max(factors[k].keys()), min(factors[k].keys()), k))
    places = np.array([pose.translation() for pose in poses_of(truth).values()])
    return Problem(
        name=f"{path.stem}-{seed}-{kind}-{share}",
        graph=odometry,
        values=datasets.chain_odometry(dataset),
        closures=tuple(alone(factors[k]) for k in order),
        true=np.array([k < len(inliers) for k in order]),
        overlapping=np.ones(len(order), dtype=bool),
        radii=RADIUS_STEPS * float(np.median(np.linalg.norm(np.diff(places, axis=0), axis=1))),
        truth=truth,
    )


def true_poses(
    odometry: gtsam.NonlinearFactorGraph, closures: Sequence[Any], values: gtsam.Values, chained: gtsam.Values
) -> gtsam.Values:
    """The optimum that explains odometry and all closures: from the file's vertices; where that is none, closure by
    closure in the plane, and from the chordal start in space, where graphs have thousands of closures.

    The chordal start (Carlone et al., Initialization Techniques for 3D SLAM, ICRA 2015) takes rotations for matrices.

    Parameters
    ----------
    odometry : gtsam.NonlinearFactorGraph
        With a prior.
    closures : sequence of between factors
    values, chained : gtsam.Values
        The file's vertices, and the odometry's own.

    Raises
    ------
    InvalidOptionError
        χ² is beyond the quantile `BORNE_OUT` from every start: nobody knows which closures are true.
    """
    # all at once, from the vertices
    whole = graph_of([*factors_of(odometry), *closures])
    found = _optimum(whole, values)
    if _is_borne_out(whole, found):
        return found

    # in space
    if isinstance(poses_of(values)[0], gtsam.Pose3):
        found = _optimum(whole, gtsam.InitializePose3.initialize(whole))
        if not _is_borne_out(whole, found):
            raise _unexplained(whole, found, "all closures")
        return found

    # in the plane
    graph, found = gtsam.NonlinearFactorGraph(odometry), chained
    for closure in sorted(closures, key=lambda each: (max(each.keys()), min(each.keys()))):
        graph.push_back(closure)
        found = _optimum(graph, found)
        if not _is_borne_out(graph, found):
            ends = f"the closure between {min(closure.keys())} and {max(closure.keys())}"
            raise _unexplained(graph, found, ends)
    return found


def _unexplained(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, last: str) -> InvalidOptionError:
    chi2 = 2 * graph.error(values)
    return InvalidOptionError(
        f"expected a graph that one trajectory explains, got χ² {chi2:.0f} with {last}; leave the graph out"
    )


def _optimum(graph: gtsam.NonlinearFactorGraph, start: gtsam.Values) -> gtsam.Values:
    return gtsam.LevenbergMarquardtOptimizer(graph, start).optimize()


def _is_borne_out(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> bool:
    freedom = sum(factor.dim() for factor in factors_of(graph)) - values.dim()
    return bool(2 * graph.error(values) <= stats.chi2.ppf(BORNE_OUT, freedom))


def _outliers(truth: gtsam.Values, inliers: list[Any], kind: str, random: np.random.Generator) -> Iterator[Any]:
    """False closures without end, each with the noise model and, the first of a group, the pose of a true closure."""
    n = truth.size()
    poses = list(poses_of(truth).values())
    places = np.array([pose.translation() for pose in poses])
    together = GROUP if "grouped" in kind else 1
    local = kind in ("local", "grouped")
    while True:
        i, j = _ends(places, local, random)
        like = inliers[int(random.integers(len(inliers)))]
        for k in range(min(together, n - max(i, j))):
            moved = poses[i + k].between(poses[i]).compose(like.measured()).compose(poses[j].between(poses[j + k]))
            factor = between(i + k, j + k, moved, like.noiseModel())
            far = np.linalg.norm(places[i + k] - places[j + k]) > APART_M
            if far and 2 * factor.error(truth) > stats.chi2.ppf(0.99, factor.dim()):
                yield factor


def _ends(places: NDArray[np.float64], local: bool, random: np.random.Generator) -> tuple[int, int]:
    """Two keyframes that lie far apart, the earlier first."""
    while True:
        i, j = sorted(random.choice(len(places), 2, replace=False).tolist())
        if local:
            far = np.flatnonzero(np.linalg.norm(places[i:] - places[i], axis=1) > APART_M)
            if not len(far):
                continue
            j = min(i + int(far[0]) + int(random.integers(LOCAL)), len(places) - 1)
        if np.linalg.norm(places[i] - places[j]) > APART_M:
            return i, j
