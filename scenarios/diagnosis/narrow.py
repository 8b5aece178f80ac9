"""Maps of a camera with a narrow field of view: spheres know neither the camera's direction nor walls.

The same drives, landmarks and damages as `covisible`, pair by pair, in the worlds that a camera is driven through.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.diagnosis import Diagnosis
from scenarios.diagnosis import covisible, damage
from scenarios.diagnosis.courses import Course, course
from scenarios.diagnosis.damage import Case
from scenarios.diagnosis.stretches import Pairs
from scenarios.worlds import sensors
from scenarios.worlds.solid import Array

WORLDS = ("storeys", "campus")
"""Those that a camera is driven through."""

VARIANTS = ("covisible", "narrow")
"""The layouts' own camera, and the narrow one."""

CAMERA = replace(sensors.CAMERA, half_width_rad=float(np.radians(25)), elevations_rad=(-np.radians(19), np.radians(19)))
"""A field of view of 50° by 38°, a picture of 4 to 3; that of `sensors.CAMERA` is 100° by 70°."""

KINDS = ("missed closure", "different view")
"""Those between which the view tells."""

TURNED = float(np.radians(60))
"""Angle between two looks from which they have nothing in common, rad."""


def case(world: str, seed: int, kind: str) -> Case:
    """A course through a world with damage, seen by a narrow camera.

    Parameters
    ----------
    world : str
        One of `WORLDS`.
    seed : int
    kind : str
        One of `covisible.DAMAGES`.
    """
    return covisible.case(world, seed, kind, CAMERA)


def overlaps(world: str, seed: int, found: Diagnosis) -> dict[str, Any]:
    """Overlaps that are no edges: how many, of cameras that look elsewhere, and through a wall; places of two kinds.

    Of the places: how many are of the kind, and how many of these a camera could tie.

    Parameters
    ----------
    world : str
    seed : int
    found : Diagnosis
    """
    driven, integrity = course(world, seed), found.integrity
    counts: dict[str, Any] = {}
    for name, pairs in (("fusion", integrity.fusion_edges), ("collision", integrity.collision_edges)):
        counts |= {name: len(pairs), f"{name}_turned": int((turns(driven, pairs) > TURNED).sum())}
        counts[f"{name}_walled"] = int(walled(driven, pairs).sum())
    for kind in KINDS:
        own = [place for place in found.places if place.kind == kind]
        counts[kind] = [len(own), sum(can_be_tied(driven, place.edges) for place in own)]
    return counts


def turns(driven: Course, pairs: Pairs) -> Array:
    """Angle between the true looks of two keyframes, (k,) rad.

    Parameters
    ----------
    driven : Course
    pairs : (k, 2) int
    """
    looks = np.array([pose.rotation().matrix()[:, 0] for pose in driven.truth])
    i, j = pairs.T
    return np.asarray(np.arccos(np.clip(np.einsum("ka,ka->k", looks[i], looks[j]), -1.0, 1.0)))


def walled(driven: Course, pairs: Pairs) -> NDArray[np.bool_]:
    """Whether a surface parts the true places of two keyframes, (k,) bool.

    Parameters
    ----------
    driven : Course
    pairs : (k, 2) int
    """
    places = np.array([pose.translation() for pose in driven.truth])
    i, j = pairs.T
    return driven.layout.solid.parts(places[i], places[j])


def can_be_tied(driven: Course, pairs: Pairs) -> bool:
    """Whether some pair of keyframes can see the same: no surface between, and looks that are not far apart.

    Parameters
    ----------
    driven : Course
    pairs : (k, 2) int
    """
    return bool((~walled(driven, pairs) & (turns(driven, pairs) <= TURNED)).any())


def paired(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Lines of Markdown: the same maps seen by the layouts' camera and by the narrow camera, side by side."""
    of = {
        variant: _counts([row for row in rows if row["variant"] == variant and "failed" not in row])
        for variant in VARIANTS
    }
    yield f"| | {' | '.join(VARIANTS)} |"
    yield "|" + "---|" * (1 + len(VARIANTS))
    for name in of[VARIANTS[0]]:
        yield f"| {name} | {' | '.join(of[variant][name] for variant in VARIANTS)} |"


def _counts(rows: Sequence[dict[str, Any]]) -> dict[str, str]:
    """The compared numbers of a camera's maps."""
    # verdicts of all maps, and overlaps of intact ones
    right = sum(row["verdict"] == row["expected"] for row in rows)
    open_ = sum(row["verdict"] == "undecided" for row in rows)
    one = [row for row in rows if len(row["ranks"]) == 1]
    intact = [row for row in rows if row["damage"] == damage.NOTHING]
    fusion, collision = (sum(row[name] for row in intact) for name in ("fusion", "collision"))
    turned, wall = (
        sum(row[f"{name}_{what}"] for row in intact for name in ("fusion", "collision"))
        for what in ("turned", "walled")
    )

    # in words
    return {
        "maps": str(len(rows)),
        "verdict right, undecided, wrong": f"{right}, {open_}, {len(rows) - right - open_}",
        "one false closure, least probable": f"{sum(row['ranks'] == [1] for row in one)} of {len(one)}",
        "one false closure, seen in collisions": f"{sum(bool(row['visible']) for row in one)} of {len(one)}",
        "intact, called inconsistent": f"{sum(row['verdict'] == 'inconsistent' for row in intact)} of {len(intact)}",
        "intact, overlaps inserted": str(fusion + collision),
        "intact, explained": str(fusion),
        "intact, looks more than 60° apart": str(turned),
        "intact, through a wall": str(wall),
        "intact, explained and through a wall": str(sum(row["fusion_walled"] for row in intact)),
        **{
            f"{kept}, called {kind}: places, a camera could tie": "{}, {}".format(
                *(sum(row[kind][k] for row in rows if row["damage"] == kept) for k in range(2))
            )
            for kept in (damage.NOTHING, damage.ODOMETRY)
            for kind in KINDS
        },
    }
