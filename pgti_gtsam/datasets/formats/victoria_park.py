"""The Victoria Park file of the GTSAM wheel, and others of its grammar.

``ODOMETRY i j x y θ C11 C12 C13 C22 C23 C33`` and ``LANDMARK pose tree x y C11 C12 C22``: metres, radians and
COVARIANCES. That they are no information matrices shows in the wheel itself: ``victoriaPark_reduced_1k.g2o``
writes 1e-4 as 100 and 0.4 as 1.581139, the inverse of the square root; GTSAM's reader takes both for
covariances too. That file holds a LANDMARK's covariance to be the covariance at 10 m; here the covariance is carried
over to bearing and range exactly, at the range of each sighting.
"""

from __future__ import annotations

from pgti_gtsam.datasets.assembly import assemble, between_entries, planar_poses
from pgti_gtsam.datasets.dataset import Dataset
from pgti_gtsam.datasets.landmarks import sightings
from pgti_gtsam.datasets.noise import UPPER_2, UPPER_3, information_models, inverse_covariances
from pgti_gtsam.datasets.source import Format, Source
from pgti_gtsam.datasets.text import note_ignored

NAME = "Victoria Park"
TAGS = {"ODOMETRY", "LANDMARK"}


def parse(source: Source) -> Dataset:
    """The graph of a Victoria Park file, with poses chained from the odometry.

    Raises
    ------
    FileFormatError
        A malformed line, a covariance that is not positive definite, a pose that no chain of odometry
        reaches.
    """
    file = source.file
    file.notes.append("ODOMETRY and LANDMARK hold covariances in m² and rad²; trees are read as bearing-range factors")
    steps = file.table("ODOMETRY", ids=2, widths=[3 + 6], poses=2)
    information = inverse_covariances(file, steps, steps.numbers[:, 3:][:, UPPER_3])
    models = information_models(file, steps, information)
    trees = file.table("LANDMARK", ids=2, widths=[2 + 3], poses=1)
    information = inverse_covariances(file, trees, trees.numbers[:, 2:][:, UPPER_2])
    seen = sightings(file, trees, trees.numbers[:, :2], information)
    note_ignored(file, TAGS)
    entries = between_entries(file, steps, planar_poses(steps.numbers), models)
    return assemble(file, format=NAME, poses={}, entries=entries, sightings=seen, known=TAGS)


FORMAT = Format(NAME, lambda source: bool(TAGS & source.tags), parse)
