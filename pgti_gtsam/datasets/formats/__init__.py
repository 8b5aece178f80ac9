"""The list of formats: a new format is a module with ``FORMAT``, and an entry in this list."""

from pgti_gtsam.datasets.formats import (
    bal,
    carmen,
    colmap,
    flirtlib,
    g2o,
    glim,
    gtsam_archive,
    kitti_stereo,
    orb_slam,
    pyfg,
    rtabmap,
    stella_vslam,
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
    stella_vslam.FORMAT,
    colmap.FORMAT,
    orb_slam.FORMAT,
    glim.FORMAT,
    flirtlib.FORMAT,
    carmen.FORMAT,
    pyfg.FORMAT,
    g2o.FORMAT,
    toro.FORMAT,
    victoria_park.FORMAT,
    bal.FORMAT,
    trajectory.FORMAT,
    kitti_stereo.FORMAT,
)


def named() -> str:
    """The names of all formats, as a list in a sentence."""
    return ", ".join(format.name for format in FORMATS)
