"""The factors that fix a map in space, and the smallest additions where none do.

A factor between poses conducts heat and fixes nothing in space. A prior, or a position from a satellite, connects the
vertex to a wall of fixed temperature: a grounded vertex. Where a connected part has no ground, moving it as
a whole changes no error; H is singular there, GTSAM's solver refuses, and the flow keeps the part's mean
motion at the start.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from pgti_gtsam.checks import instance, shown
from pgti_gtsam.diffusion.block_laplacian import checked_blocks, normal_equations
from pgti_gtsam.diffusion.linearisation import Linearisation, in_space
from pgti_gtsam.errors import InvalidGraphError
from pgti_gtsam.factor_graphs import check_map, joined

NO_MOTION = 1e-9
"""A motion of a part that changes errors by less, relative to what moving each of its poses alone would,
changes none. Rounding leaves 1e-13; what holds a map on purpose holds it better than this: a part of 10 000
poses with one prior as
stiff as its odometry has 1e-4."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ground:
    """Rows that fix a pose at its place, in the directions that nothing else fixes.

    Attributes
    ----------
    key : int
        The first pose of the connected part.
    matrix : (k, d) float
        Whitened Jacobian in the body frame; as stiff as the factors at the pose. The residual is zero, now
        and at the optimum: the ground chooses a solution and pulls at none.
    """

    key: int
    matrix: NDArray[np.float64]

    def linear_factor(self) -> gtsam.JacobianFactor:
        """The same as a linear GTSAM factor."""
        k = len(self.matrix)
        return gtsam.JacobianFactor(self.key, self.matrix, np.zeros(k), gtsam.noiseModel.Unit.Create(k))


def components(hessian: sparse.csr_array, dimension: int) -> NDArray[np.int32]:
    """Connected part of every vertex, (n,): poses that exchange heat, through marginalised variables too.

    Parameters
    ----------
    hessian : sparse.csr_array
        H, (n d, n d).
    dimension : int
        d.
    """
    blocks = sparse.bsr_array(checked_blocks(hessian, dimension), blocksize=(dimension, dimension))
    shape = (len(blocks.indptr) - 1,) * 2
    pattern = sparse.csr_array((np.ones(len(blocks.indices)), blocks.indices, blocks.indptr), shape=shape)
    labels: NDArray[np.int32] = csgraph.connected_components(pattern, directed=False)[1]
    return labels


def grounds(body: Linearisation) -> list[Ground]:
    """The additions that fix every part of a graph, a ground for each part that is not wholly fixed.

    A part with a position from a satellite is fixed but for the rotation about that position: only the rotation is
    grounded.
    """
    equations = normal_equations(in_space(instance(body, Linearisation, "a linearisation")))
    d, labels = equations.dimension, components(equations.hessian, equations.dimension)
    moved = np.tile(np.eye(d), (equations.n_vertices, 1))
    sums = (np.asarray(equations.hessian @ moved)).reshape(-1, d, d)
    diagonal = equations.hessian.diagonal().reshape(-1, d)

    # in each part, motions of the whole that cost nothing
    found = []
    for part in range(labels.max() + 1):
        members = np.flatnonzero(labels == part)
        scale = np.sqrt(diagonal[members].sum(axis=0))
        scale[scale == 0] = 1.0
        held, directions = np.linalg.eigh(sums[members].sum(axis=0) / np.outer(scale, scale))
        free = directions[:, held < NO_MOTION]
        if free.shape[1]:
            first = int(members[0])
            stiffness = np.sqrt(diagonal[first])
            stiffness[stiffness == 0] = 1.0
            matrix = free.T @ np.diag(stiffness) @ np.linalg.inv(body.adjoints[first])
            found.append(Ground(key=int(body.keys[first]), matrix=matrix))
    return found


def grounded(body: Linearisation, added: Sequence[Ground]) -> Linearisation:
    """The linearisation with the rows of some grounds behind the others; the slot of a ground is −1.

    Parameters
    ----------
    body : Linearisation
        Linearisation in the body frame.
    added : sequence of Ground
    """
    instance(body, Linearisation, "a linearisation")
    added = _checked(added)
    if not added:
        return body
    missing = [ground.key for ground in added if ground.key not in body.keys]
    if missing:
        raise InvalidGraphError(f"expected grounds at keyframes of the graph, got one at key {missing[0]}")

    # a row for each direction that is held
    d, width = body.dimension, body.jacobian.shape[1]
    row = {int(key): i for i, key in enumerate(body.keys)}
    blocks = []
    for ground in added:
        k, first = len(ground.matrix), row[ground.key] * d
        entry = sparse.coo_array(ground.matrix)
        blocks.append(sparse.coo_array((entry.data, (entry.row, entry.col + first)), shape=(k, width)))

    # behind those of the factors
    n_rows = sum(len(ground.matrix) for ground in added)
    return replace(
        body,
        jacobian=sparse.csr_array(sparse.vstack([body.jacobian, *blocks])),
        residual=np.concatenate([body.residual, np.zeros(n_rows)]),
        row_slots=np.concatenate([body.row_slots, np.full(n_rows, -1)]),
    )


def grounded_graph(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, added: Sequence[Ground]
) -> gtsam.NonlinearFactorGraph:
    """New GTSAM graph of the same factors and the grounds, for GTSAM's optimisers.

    Parameters
    ----------
    graph, values
    added : sequence of Ground
    """
    check_map(graph, values)
    together = joined(graph)
    for ground in _checked(added):
        together.push_back(gtsam.LinearContainerFactor(ground.linear_factor(), values))
    return together


def _checked(added: Sequence[Ground]) -> Sequence[Ground]:
    """Grounds as `grounds` returns them."""
    if not isinstance(added, Sequence) or not all(isinstance(ground, Ground) for ground in added):
        raise InvalidGraphError(f"expected grounds in a list, got {shown(added)}")
    return added
