"""The view from a pose: ranges on a grid of rays, and landmarks that are in view and not hidden.

The body looks along x, y is left, z is up.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np

from scenarios.worlds.solid import Array, Hits, Solid


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor:
    """A field of view with its grid of rays.

    Attributes
    ----------
    name : str
    half_width_rad : float
        π sees all around.
    elevations_rad : tuple of float
        Lowest and highest; equal for a scanner of one plane.
    grid : tuple of int
        Rays by azimuth and by elevation.
    reach_m : float
    n_landmarks : int
        At most so many a keyframe, the strongest in view.
    noise_m : float
        Standard deviation of a range.
    drop_out : float
        Share of landmarks in view that are missed.
    """

    name: str
    half_width_rad: float
    elevations_rad: tuple[float, float]
    grid: tuple[int, int]
    reach_m: float
    n_landmarks: int
    noise_m: float = 0.02
    drop_out: float = 0.1

    @property
    def all_around(self) -> bool:
        """Whether the sensor sees backwards."""
        return self.half_width_rad >= np.pi

    @property
    def planar(self) -> bool:
        """Whether all rays lie in a plane."""
        return self.elevations_rad[0] == self.elevations_rad[1]

    def rays(self) -> Array:
        """Unit vectors in the body, (n_azimuths, n_elevations, 3)."""
        n, m = self.grid
        azimuths = np.linspace(-self.half_width_rad, self.half_width_rad, n, endpoint=not self.all_around)
        azimuth, elevation = np.meshgrid(azimuths, np.linspace(*self.elevations_rad, m), indexing="ij")
        level = np.cos(elevation)
        return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=-1)

    def scan(self, solid: Solid, pose: gtsam.Pose3) -> Hits:
        """Every ray's end, in the body's frame; beyond reach is a miss.

        Parameters
        ----------
        solid : Solid
        pose : gtsam.Pose3
        """
        directions = self.rays().reshape(-1, 3)
        turn = pose.rotation().matrix()
        found = solid.cast(np.broadcast_to(pose.translation(), directions.shape), directions @ turn.T)
        distances = np.where(found.distances <= self.reach_m, found.distances, np.inf)
        with np.errstate(invalid="ignore"):
            points = distances[:, None] * directions
        return Hits(points=points, normals=found.normals @ turn, distances=distances)

    def sees(self, solid: Solid, pose: gtsam.Pose3, places: Array) -> Array:
        """The places that are in view and not hidden: (k,) int, in order.

        Parameters
        ----------
        solid : Solid
        pose : gtsam.Pose3
        places : (n, 3) float
            In the world.
        """
        near = np.flatnonzero(np.linalg.norm(places - pose.translation(), axis=1) < self.reach_m)
        local = (places[near] - pose.translation()) @ pose.rotation().matrix()
        distance = np.linalg.norm(local, axis=1)
        elevation = np.arcsin(local[:, 2] / distance)
        low, high = self.elevations_rad
        inside = np.abs(np.arctan2(local[:, 1], local[:, 0])) <= self.half_width_rad
        inside &= (elevation >= low - 1e-3) & (elevation <= high + 1e-3)
        near, distance = near[inside], distance[inside]
        directions = (places[near] - pose.translation()) / distance[:, None]
        hit = solid.cast(np.broadcast_to(pose.translation(), directions.shape), directions)
        return near[hit.distances > distance - 0.05]


CAMERA = Sensor(
    name="camera",
    half_width_rad=np.radians(50),
    elevations_rad=(-np.radians(35), np.radians(35)),
    grid=(48, 24),
    reach_m=40.0,
    n_landmarks=700,
)
LIDAR_2D = Sensor(
    name="2D lidar",
    half_width_rad=np.pi,
    elevations_rad=(0.0, 0.0),
    grid=(180, 1),
    reach_m=12.0,
    n_landmarks=60,
)
LIDAR_3D = Sensor(
    name="3D lidar",
    half_width_rad=np.pi,
    elevations_rad=(-np.radians(25), np.radians(15)),
    grid=(90, 12),
    reach_m=40.0,
    n_landmarks=300,
)
