"""Section 6.2: Fig. 4 on the stereo drive of KITTI 00, Fig. 5 on a drive like KITTI 05, and the blur of averaging."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pgti_gtsam import datasets, replay
from pgti_gtsam.replay import METRICS, Replay, replay_graph
from pgti_gtsam.report.curves import write_replay_png
from pgti_gtsam.report.replay import replay_document
from scenarios.paper.ways import covisible, pose_graph, way

COMPARED = (350, 400, 600, 733)
"""Keyframes at which Z̄ and Λ are compared: after the first burst of insertions, in between, just before the second."""

LIKE_KITTI_05 = [(-300, 0), (218, 0), (218, 200), (60, 200), (60, 2.5), (20, 2.5), (20, -300), (500, -300), (500, -100),
                 (150, -100), (150, -2.5), (190, -2.5)]  # fmt: skip
"""A lap whose end lies on its beginning, and a second one that ends beside the first, m."""


def stereo() -> Replay:
    """The stereo drive of KITTI 00 that GTSAM ships, landmarks and all."""
    dataset = datasets.builtin()
    return replay(dataset.graph, dataset.values, radii=dataset.radii)


def like_kitti_05() -> Replay:
    """748 keyframes with two bursts of insertions, the second at the end."""
    positions = way(LIKE_KITTI_05, 748)
    return replay_graph(pose_graph(positions, covisible(748, 748 * 17), 1.4))


def run(folder: Path) -> dict[str, Any]:
    """Replay both, draw both, and say which metrics answer to insertions and how averaging blurs."""
    found = {}
    for name, title, grown in (
        ("figure_4", "KITTI 00, stereo", stereo()),
        ("figure_5", "a drive like KITTI 05", like_kitti_05()),
    ):
        document = replay_document(grown, name=title, file_format="replay")
        write_replay_png(document, folder / f"{name}.png")
        found[name] = {"n_keyframes": len(grown.pose_graph), "bursts": bursts(grown), "lags": document["lags"]}
    found["figure_5"]["blur"] = blur(grown)
    return found


def bursts(grown: Replay) -> list[tuple[int, int]]:
    """First and last keyframe of each run of insertions; runs less than ten keyframes apart are joined."""
    at = grown.curve("n_keyframes")[grown.insertion_signal].astype(int)
    breaks = np.flatnonzero(np.diff(at) > 10)
    return [(int(run[0]), int(run[-1])) for run in np.split(at, breaks + 1)] if len(at) else []


def blur(grown: Replay) -> list[dict[str, float]]:
    """Z̄, Λ and the stable score after the first burst, and the rest of each where no edge was inserted since."""
    at = grown.curve("n_keyframes").astype(int).tolist()
    curves = {name: grown.curve(name) for name in ("mean_score", "score", "stable_score")}
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
