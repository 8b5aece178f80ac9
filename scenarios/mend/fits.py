"""Fits of pairs whose true relative pose is known: how many the sensors confirm, and how honest their ties are.

Half of the pairs are where the prediction says, within a region of 0.3, 1 or 3 ρ; the others are far apart. Submaps
are on odometry alone, so that they drift. The rule of `verdicts` and the constants were chosen on such pairs of
`CHOSEN`, and of the same worlds at seed 1001; `CHECKED` had no part in the choice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

import pgti_gtsam as pgti
from pgti_gtsam import datasets
from pgti_gtsam.mending import Clouds, Wanted
from pgti_gtsam.mending.alignment import FIT, Alignment, Cloud, align, is_thin, lengths
from pgti_gtsam.mending.submap import Submaps
from pgti_gtsam.mending.verdicts import sensors_say
from pgti_gtsam.track import track_of
from scenarios import worlds as driving
from scenarios.mend.aces import odometry_of, optimum_of
from scenarios.mend.logs import chained
from scenarios.mend.worlds import LIDAR, seen_from

CHOSEN = ("fr079", "aces", "streets 1000", "garage 1000")
CHECKED = ("mit-cscail", "streets 1002", "garage 1002", "storeys 1002")

N_PAIRS = 120
REGIONS = ((0.3, 0.05), (1.0, 0.15), (3.0, 0.3))
"""Standard deviations of predictions, in ρ and rad."""

NEAR, ELSEWHERE = 3.0, 12.0
"""Distance in ρ within which the keyframes of a pair lie, and beyond which another one is elsewhere."""

TRUE, TRUE_RAD = 0.3, 0.1
"""How far a true fit may lie from the truth, in ρ and rad."""

LATER = 30
"""Least number of keyframes between those of a pair."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Known:
    """A map of odometry with its clouds, and where its keyframes truly are."""

    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    truth: Sequence[Any]
    clouds: Clouds
    radii: dict[int, float]


def row(name: str, data: Path | None) -> dict[str, Any]:
    """Count fits of a log, or of a world and its seed.

    Parameters
    ----------
    name : str
    data : Path or None
        Folder of all data, of which logs are read.
    """
    known, random = _world(*name.split()) if " " in name else _log(name, data or Path()), np.random.default_rng(0)
    submaps = _submaps(known)
    found: list[tuple[bool, bool, bool, float]] = []
    while len(found) < N_PAIRS:
        is_far, (length, angle) = len(found) % 2 == 1, REGIONS[len(found) // 2 % len(REGIONS)]
        found.append(_tried(known, submaps, is_far, length * submaps.unit_m, angle, random))

    # how many are confirmed of the true and of the other fits, and what ties miss in units of their own sigmas
    confirmed, true, far, squares = (np.array(each) for each in zip(*found, strict=True))
    own = squares[confirmed & true]
    dimension = 3 if isinstance(known.truth[0], gtsam.Pose2) else 6
    return {
        "n_true": int(true.sum()),
        "true_confirmed": int((true & confirmed).sum()),
        "n_slipped": int((~true & ~far).sum()),
        "slipped_confirmed": int((~true & ~far & confirmed).sum()),
        "n_elsewhere": int(far.sum()),
        "elsewhere_confirmed": int((far & confirmed).sum()),
        "sigmas_median": float(np.sqrt(np.median(own) / chdtri(dimension, 0.5))) if len(own) else None,
        "sigmas_90": float(np.sqrt(np.quantile(own, 0.9) / chdtri(dimension, 0.1))) if len(own) else None,
    }


def _log(name: str, data: Path) -> Known:
    if name == "aces":
        whole = datasets.read(data / "radish_aces" / "aces.clf.bz2")
        graph, values, best = odometry_of(whole), whole.values, optimum_of(whole)
    else:
        whole = datasets.read(data / "scan_pose_graphs" / f"{name}.log")
        graph, values, best = odometry_of(whole), chained(whole), whole.values
    truth = [best.atPose2(key) for key in sorted(best.keys())]
    return Known(
        graph=graph, values=values, truth=truth, clouds=pgti.scans_of(whole.scans), radii=dict(whole.radii or {})
    )


def _world(world: str, seed: str) -> Known:
    driven = driving.drive(world, int(seed))
    graph, values, random = gtsam.NonlinearFactorGraph(), gtsam.Values(), np.random.default_rng(driven.seed)
    noise = gtsam.noiseModel.Diagonal.Sigmas(driven.odometry.sigmas)
    for i, step in enumerate(driven.odometry.steps):
        graph.add(gtsam.BetweenFactorPose3(i, i + 1, step, noise))
    for key, pose in enumerate(driven.odometry.chained(driven.truth[0])):
        values.insert(key, pose)
    scans = {key: seen_from(LIDAR, driven.layout.solid, pose, random) for key, pose in enumerate(driven.truth)}
    return Known(graph=graph, values=values, truth=driven.truth, clouds=pgti.scans_of(scans), radii=driven.radii)


def _submaps(known: Known) -> Submaps:
    pose_graph = pgti.from_gtsam(known.graph, known.values, radii=known.radii)
    at = known.values.atPose2 if isinstance(known.truth[0], gtsam.Pose2) else known.values.atPose3
    return Submaps(
        clouds=known.clouds,
        keys=pose_graph.keys.tolist(),
        poses=[at(int(key)) for key in pose_graph.keys],
        track=track_of(pose_graph),
        unit_m=float(np.median(pose_graph.radii[pose_graph.radii > 0])),
    )


def _tried(
    known: Known, submaps: Submaps, is_far: bool, length_m: float, angle: float, random: np.random.Generator
) -> tuple[bool, bool, bool, float]:
    """A pair tried: whether confirmed, whether true, whether the second keyframe is elsewhere; the square of sigmas."""
    # two keyframes, and a prediction that is off
    places = np.array([pose.translation() for pose in known.truth])
    i, j = _drawn(places, submaps, random)
    turning = np.array([False, False, True] if places.shape[1] == 2 else [True] * 3 + [False] * 3)
    sigmas = np.where(turning, angle, length_m)
    predicted = known.truth[i].between(known.truth[j]).retract(random.normal(size=len(sigmas)) * sigmas)
    if is_far:
        apart = np.linalg.norm(places - places[i], axis=1)
        j = int(random.choice(np.flatnonzero(apart > ELSEWHERE * submaps.unit_m)))

    # what the sensors say of the fit
    wanted = Wanted(
        keyframes=(i, j), keys=(i, j), place=None, pose=predicted, covariance=np.diag(sigmas**2), allowance_m=length_m
    )
    ends = [submaps.at(k) for k in (i, j)]
    if any(map(is_thin, ends)):
        return False, False, is_far, np.nan
    first, second = (Cloud.of(end, submaps.unit_m) for end in ends)
    fit = align(first, second, predicted, wanted.covariance)
    if fit is None:
        return False, False, is_far, np.nan
    off = _missed(known.truth[i].between(known.truth[j]), fit, submaps.unit_m)
    is_true = np.linalg.norm(off[~turning]) < TRUE and np.linalg.norm(off[turning]) < TRUE_RAD and not is_far
    confirmed = sensors_say(wanted, fit, submaps.unit_m)[0] == "confirmed"
    return confirmed, bool(is_true), is_far, float(off @ fit.stiffness @ off) / FIT**2


def _missed(true: Any, fit: Alignment, unit_m: float) -> NDArray[np.float64]:
    """What a fit misses, in ρ and rad, in its own tangent space."""
    return np.asarray(fit.pose.localCoordinates(true)) / lengths(len(fit.stiffness), unit_m)


def _drawn(places: NDArray[np.float64], submaps: Submaps, random: np.random.Generator) -> tuple[int, int]:
    """Two keyframes with clouds, near each other and not next to each other on the track."""
    has = np.array([key in submaps.clouds for key in submaps.keys])
    while True:
        i = int(random.choice(np.flatnonzero(has)))
        near = has & (np.linalg.norm(places - places[i], axis=1) < NEAR * submaps.unit_m)
        near &= np.arange(len(has)) > i + LATER
        if near.any():
            return i, int(random.choice(np.flatnonzero(near)))
