"""The list of formats: a new one is a module with ``FORMAT``, and a place in this list."""

from pgti_gtsam.datasets.formats import (
    carmen,
    flirtlib,
    g2o,
    gtsam_archive,
    kitti_stereo,
    rtabmap,
    toro,
    trajectory,
    victoria_park,
)
from pgti_gtsam.datasets.source import Format

# The first that recognises a source reads it: those that name themselves in their first bytes come before text,
# and a kind of text comes before those whose lines it shares.
FORMATS: tuple[Format, ...] = (
    rtabmap.FORMAT,
    gtsam_archive.FORMAT,
    flirtlib.FORMAT,
    carmen.FORMAT,
    g2o.FORMAT,
    toro.FORMAT,
    victoria_park.FORMAT,
    trajectory.FORMAT,
    kitti_stereo.FORMAT,
)


def named() -> str:
    """The names of all formats, as a list in a sentence."""
    return ", ".join(format.name for format in FORMATS)
