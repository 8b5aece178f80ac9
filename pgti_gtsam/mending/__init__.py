"""Wrong closures out, closures in that the sensors confirm."""

from pgti_gtsam.mending.clouds import Clouds, clouds_in, scans_of
from pgti_gtsam.mending.mending import mend
from pgti_gtsam.mending.records import Attempt, Mended, Wanted

__all__ = ["Attempt", "Clouds", "Mended", "Wanted", "clouds_in", "mend", "scans_of"]
