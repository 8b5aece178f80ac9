"""Pose graphs that hypothesis draws, degenerate ones on purpose."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

import pgti_gtsam as pgti


@st.composite
def pose_graphs(draw, max_size=16):
    """Random tracks with closures; gaps, coincident keyframes, zero and huge radii occur."""
    n = draw(st.integers(1, max_size))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    positions = rng.normal(size=(n, 3)) * draw(st.sampled_from([0.5, 3.0, 10.0]))
    if draw(st.booleans()):
        positions = np.cumsum(positions, axis=0)
    if n > 1 and draw(st.booleans()):
        positions[rng.integers(n)] = positions[rng.integers(n)]
    radii = rng.exponential(size=n) * draw(st.sampled_from([0.0, 0.3, 1.0, 4.0, 1000.0]))
    radii[rng.random(n) < draw(st.sampled_from([0.0, 0.3]))] = 0.0
    chain = [(i, i + 1) for i in range(n - 1) if rng.random() > draw(st.sampled_from([0.0, 0.2, 1.0]))]
    n_closures = draw(st.integers(0, n)) if n > 1 else 0
    closures = [tuple(rng.choice(n, 2, replace=False)) for _ in range(n_closures)]
    return pgti.PoseGraph(keys=np.arange(n), positions=positions, edges=chain + closures, radii=radii)
