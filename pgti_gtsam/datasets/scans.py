"""Laser scans of CARMEN's messages: what was seen, from where, when, and how near the nearest obstacle was.

``FLASER n readings… x y θ odom_x odom_y odom_θ time host logger_time``;
``ROBOTLASER1 type start field_of_view resolution maximum accuracy remission_mode n readings… m remissions…
laser_x laser_y laser_θ robot_x robot_y robot_θ v ω forward side turn_axis time host logger_time``.
Metres, radians and seconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pgti_gtsam.datasets.text import Line, TextFile, parse_numbers, quote


class Scan(NamedTuple):
    """Line, ranges (n,), the scanner's maximum range, the robot's pose x, y, θ by odometry, the time."""

    line: int
    ranges_m: NDArray[np.float64]
    maximum_m: float
    robot: tuple[float, float, float]
    time_s: float


def read_scan(file: TextFile, line: Line) -> Scan:
    """The scan of a FLASER or ROBOTLASER1 line.

    FLASER does not say how far its scanner reaches: the maximum is infinite.

    Raises
    ------
    FileFormatError
        The readings are not as many as announced, or a field is no number.
    """
    if line.fields[0] == "FLASER":
        ranges, rest = _counted(file, line, line.fields[1:])
        return _scan(file, line, ranges, np.inf, rest, behind_pose=0)
    header = parse_numbers(file, line, line.fields[1:8])
    ranges, rest = _counted(file, line, line.fields[8:])
    _, rest = _counted(file, line, rest)
    return _scan(file, line, ranges, header[4], rest, behind_pose=5)


def _scan(
    file: TextFile, line: Line, ranges: NDArray[np.float64], maximum_m: float, rest: Sequence[str], behind_pose: int
) -> Scan:
    """The poses of laser and robot, ``behind_pose`` numbers that are of no use here, then time, host, time."""
    expected = 6 + behind_pose + 3
    if len(rest) != expected:
        message = f"expected {expected} fields behind the readings of {line.fields[0]}, got {len(rest)}"
        raise file.error(message, line.number)
    x, y, heading, *_, time_s = parse_numbers(file, line, rest[3:-2])
    return Scan(line.number, ranges, maximum_m, (x, y, heading), time_s)


def _counted(file: TextFile, line: Line, fields: Sequence[str]) -> tuple[NDArray[np.float64], Sequence[str]]:
    """Numbers with their count in front, and the fields behind them."""
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
    """Smallest range that is a measurement, or None when nothing was hit.

    Ranges at or beyond the scanner's maximum, at or below zero, and such that are no numbers are none. A
    scanner writes a range beyond its maximum where no echo came back (81.91 m in logs of the SICK LMS).
    """
    limit = min(scan.maximum_m, maximum_m)
    valid = scan.ranges_m[(scan.ranges_m > 0.0) & (scan.ranges_m < limit)]
    return float(valid.min()) if valid.size else None
