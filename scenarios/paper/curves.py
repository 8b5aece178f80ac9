"""Section 6.2: Fig. 4 on the stereo drive of KITTI 00, Fig. 5 on a drive like KITTI 05, and the blur of averaging."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pgti_gtsam as pgti
from pgti_gtsam import datasets, replay
from pgti_gtsam.replaying import METRICS, Replay, lag, replay_graph
from pgti_gtsam.replaying.growth import Stage, grown
from pgti_gtsam.report.curves import write_replay_png
from pgti_gtsam.report.replay import replay_document
from pgti_gtsam.spectral.laplacian import connected_components, laplacian
from pgti_gtsam.spectral.spectrum import extreme_eigenvalues
from scenarios.paper.ways import Pairs, covisible, pose_graph, way

COMPARED = (350, 400, 600, 733)
"""Keyframes at which Z̄ and Λ are compared: after the first burst of insertions, in between, just before the second."""

LIKE_KITTI_05 = [(-300, 0), (218, 0), (218, 200), (60, 200), (60, 2.5), (20, 2.5), (20, -300), (500, -300), (500, -100),
                 (150, -100), (150, -2.5), (190, -2.5)]  # fmt: skip
"""A lap whose end lies on its beginning, and a second one that ends beside the first, m."""


NEIGHBOURS, RADIUS_M = 17, 1.4
"""Of the drive like KITTI 05: as many edges a keyframe as the paper's KITTI 00 has."""

UNEVEN_SEEDS = range(5)
"""Of the keyframe from which on the stereo drive's covisibility is laid along the drive like KITTI 05."""


def stereo() -> Replay:
    """The stereo drive of KITTI 00 that GTSAM ships, landmarks and all."""
    dataset = datasets.builtin()
    return replay(dataset.graph, dataset.values, radii=dataset.radii)


def like_kitti_05() -> Replay:
    """748 keyframes with two bursts of insertions, the second at the end."""
    positions = way(LIKE_KITTI_05, 748)
    return replay_graph(pose_graph(positions, covisible(748, 748 * NEIGHBOURS), RADIUS_M))


def uneven_lags() -> list[dict[str, Any]]:
    """How soon ΔẼ answers on the drive like KITTI 05 where keyframes see as unevenly far as on the stereo drive.

    With as many ties at every keyframe any inserted edge touches a densest keyframe, and λ_max rises.
    """
    dataset = datasets.builtin()
    real = pgti.from_gtsam(dataset.graph, dataset.values, radii=dataset.radii)
    reach = np.bincount(real.edges[:, 0], minlength=len(real))[: -np.ptp(real.edges, axis=1).max()]
    positions, found = way(LIKE_KITTI_05, 748), []
    for seed in UNEVEN_SEEDS:
        start = int(np.random.default_rng(seed).integers(len(reach)))
        along = np.resize(np.roll(reach, -start), 748) * NEIGHBOURS / reach.mean()
        graph = pose_graph(positions, reaching(along.round().astype(int)), RADIUS_M)
        stages = list(grown(graph, range(2, len(graph) + 1)))
        change = [_change(stage) for stage in stages]
        found.append({"seed": seed, **asdict(lag(np.array(change), np.array([s.n_new > 0 for s in stages])))})
    return found


def reaching(reach: NDArray[np.int64]) -> Pairs:
    """Every keyframe tied to so many next ones."""
    pairs = [(i, j) for i, count in enumerate(reach.tolist()) for j in range(i + 1, min(i + 1 + count, len(reach)))]
    return np.array(pairs)


def _change(stage: Stage) -> float:
    """ΔẼ: by how much inserted edges raise λ_max."""
    if not len(stage.inserted_edges):
        return 0.0
    n, merged = stage.n_keyframes, np.concatenate([stage.edges, stage.inserted_edges])
    before, after = (
        extreme_eigenvalues(laplacian(n, edges), connected_components(n, edges)[1])[1]
        for edges in (stage.edges, merged)
    )
    return after - before


def run(folder: Path) -> dict[str, Any]:
    """Replay both, draw both, and say which metrics answer to insertions and how averaging blurs."""
    found = {}
    for name, title, replayed in (
        ("figure_4", "KITTI 00, stereo", stereo()),
        ("figure_5", "a drive like KITTI 05", like_kitti_05()),
    ):
        document = replay_document(replayed, name=title, file_format="replay")
        write_replay_png(document, folder / f"{name}.png")
        found[name] = {"n_keyframes": len(replayed.pose_graph), "bursts": bursts(replayed), "lags": document["lags"]}
    found["figure_5"]["blur"] = blur(replayed)
    found["figure_5"]["uneven"] = uneven_lags()
    return found


def bursts(replayed: Replay) -> list[tuple[int, int]]:
    """First and last keyframe of each run of insertions; runs less than ten keyframes apart are joined."""
    at = replayed.curve("n_keyframes")[replayed.insertion_signal].astype(int)
    breaks = np.flatnonzero(np.diff(at) > 10)
    return [(int(run[0]), int(run[-1])) for run in np.split(at, breaks + 1)] if len(at) else []


def blur(replayed: Replay) -> list[dict[str, float]]:
    """Z̄, Λ and the stable score after the first burst, and the rest of each where no edge was inserted since."""
    at = replayed.curve("n_keyframes").astype(int).tolist()
    curves = {name: replayed.curve(name) for name in ("mean_score", "score", "stable_score")}
    first = at.index(COMPARED[0])
    return [
        {"n_keyframes": size}
        | {name: float(curve[at.index(size)]) for name, curve in curves.items()}
        | {f"{name}_kept": float(curve[at.index(size)] / curve[first]) for name, curve in curves.items()}
        for size in COMPARED
    ]


def markdown(found: dict[str, Any]) -> list[str]:
    """Lags of all metrics in both figures."""
    lines = [
        "| metric | lag | correlation | without lag | lag | correlation | without lag |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, one, other in zip(METRICS.values(), found["figure_4"]["lags"], found["figure_5"]["lags"], strict=True):
        cells = [f"{each['lag']} | {each['correlation']:.2f} | {each['at_zero']:.2f}" for each in (one, other)]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return lines


def blur_markdown(found: dict[str, Any]) -> list[str]:
    """The share of Z̄, Λ and the stable score left between the two bursts of Fig. 5."""
    lines = ["| keyframes | Z̄ | kept | Λ | kept | stable score | kept |", "|---|---|---|---|---|---|---|"]
    for row in found["figure_5"]["blur"]:
        cells = [f"{row[name]:.3f} | {row[f'{name}_kept']:.2f}" for name in ("mean_score", "score", "stable_score")]
        lines.append(f"| {row['n_keyframes']} | " + " | ".join(cells) + " |")
    return lines


def uneven_markdown(found: dict[str, Any]) -> str:
    """The lag of ΔẼ where covisibility is as uneven as the stereo drive's, a layout at a time."""
    return ", ".join(
        f"{each['lag']} ({each['correlation']:.2f}; without lag {each['at_zero']:.2f})"
        for each in found["figure_5"]["uneven"]
    )
