"""Laser scans of CARMEN's messages: readings, sensor pose, time, and the distance of the nearest obstacle.

``FLASER n readings… x y θ odom_x odom_y odom_θ time host logger_time``;
``ROBOTLASER1 type start field_of_view resolution maximum accuracy remission_mode n readings… m remissions…
laser_x laser_y laser_θ robot_x robot_y robot_θ v ω forward side turn_axis time host logger_time``.
Metres, radians and seconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.datasets.text import Line, TextFile, parse_numbers, quote

Planar = tuple[float, float, float]
"""x and y in m and heading in rad."""


class Scan(NamedTuple):
    """Line, ranges and bearings (n,), the scanner's maximum range, the scanner's pose on the robot, the robot's pose by
    odometry, the time."""

    line: int
    ranges_m: NDArray[np.float64]
    bearings_rad: NDArray[np.float64]
    maximum_m: float
    mount: gtsam.Pose2
    robot: Planar
    time_s: float

    def points(self, maximum_m: float = np.inf) -> NDArray[np.float64]:
        """Where the valid readings end, seen from the robot: (k, 2) m."""
        kept = valid(self, maximum_m)
        ranges, bearings = self.ranges_m[kept], self.bearings_rad[kept]
        ends = np.stack([ranges * np.cos(bearings), ranges * np.sin(bearings)])
        return np.asarray((self.mount.matrix() @ np.vstack([ends, np.ones(len(ranges))]))[:2].T)


def read_scan(file: TextFile, line: Line) -> Scan:
    """The scan of a FLASER or ROBOTLASER1 line.

    FLASER does not say how far the scanner reaches: the maximum is infinite. Nor does FLASER name bearings: bearings
    span half a turn, ends included where the readings are odd in number (181 of a SICK LMS, a reading a degree). The
    first pose is the that some programs correct, so the scanner is taken to sit where the robot is.

    Parameters
    ----------
    file : TextFile
        Named in errors.
    line : Line

    Raises
    ------
    FileFormatError
        The readings are not as many as announced, or a field is no number.
    """
    if line.fields[0] == "FLASER":
        ranges, rest = _counted(file, line, line.fields[1:])
        _, robot, time_s = _poses(file, line, rest, behind=0)
        n = len(ranges)
        bearings = np.pi * (np.arange(n, dtype=np.float64) / max(n - n % 2, 1) - 0.5)
        return Scan(line.number, ranges, bearings, np.inf, gtsam.Pose2(), robot, time_s)
    header = parse_numbers(file, line, line.fields[1:8])
    ranges, rest = _counted(file, line, line.fields[8:])
    _, rest = _counted(file, line, rest)
    laser, robot, time_s = _poses(file, line, rest, behind=5)
    mount = gtsam.Pose2(*robot).between(gtsam.Pose2(*laser))
    bearings = header[1] + header[3] * np.arange(len(ranges), dtype=np.float64)
    return Scan(line.number, ranges, bearings, header[4], mount, robot, time_s)


def _poses(file: TextFile, line: Line, rest: Sequence[str], behind: int) -> tuple[Planar, Planar, float]:
    """The poses of laser and robot, ``behind`` numbers that are of no use here, then time, host, time."""
    expected = 6 + behind + 3
    if len(rest) != expected:
        message = f"expected {expected} fields behind the readings of {line.fields[0]}, got {len(rest)}"
        raise file.error(message, line.number)
    x, y, heading, robot_x, robot_y, robot_heading, *_, time_s = parse_numbers(file, line, rest[:-2])
    return (x, y, heading), (robot_x, robot_y, robot_heading), time_s


def _counted(file: TextFile, line: Line, fields: Sequence[str]) -> tuple[NDArray[np.float64], Sequence[str]]:
    """Numbers with a leading count, and the fields behind the numbers."""
    count = fields[0] if fields else ""
    if not (count.isascii() and count.isdecimal() and int(count[:9]) < len(fields)):
        message = f"expected a count and as many numbers, got count {quote(count)} and {len(fields)} fields"
        raise file.error(message, line.number)
    end = 1 + int(count)
    try:
        return np.array([float(field) for field in fields[1:end]]), fields[end:]
    except ValueError as error:
        raise file.error(f"expected a range in metres: {quote(error, 80)}", line.number) from None


def smallest_range(scan: Scan, maximum_m: float = np.inf) -> float | None:
    """Smallest range that is a measurement, or None when nothing was hit: see `valid`.

    Parameters
    ----------
    scan : Scan
    maximum_m : float
        As for `valid`.
    """
    ranges = scan.ranges_m[valid(scan, maximum_m)]
    return float(ranges.min()) if ranges.size else None


def valid(scan: Scan, maximum_m: float = np.inf) -> NDArray[np.bool_]:
    """The readings that are measurements, (n,).

    Ranges at or beyond the scanner's maximum, at or below zero, and such that are no numbers are none. A
    scanner writes a range beyond its maximum where no echo came back (81.91 m in logs of the SICK LMS).

    Parameters
    ----------
    scan : Scan
    maximum_m : float
        The reading for 'no echo'.
    """
    return np.asarray((scan.ranges_m > 0.0) & (scan.ranges_m < min(scan.maximum_m, maximum_m)))
