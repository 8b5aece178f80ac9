"""Wrong closures out, closures in that the sensors confirm."""

from pgti_gtsam.mend.clouds import Clouds, clouds_in, scans_of
from pgti_gtsam.mend.mending import mend
from pgti_gtsam.mend.records import Attempt, Mended, Wanted

__all__ = ["Attempt", "Clouds", "Mended", "Wanted", "clouds_in", "mend", "scans_of"]
