"""The normal matrix H = JᵀΩJ of a pose graph as a block Laplacian, and its distance from a block Laplacian.

A matrix of d × d blocks is a block Laplacian when every block row sums to zero: the diagonal is the sum of the
flow to the neighbours, so a field that is the same at all vertices stays. For H that is
invariance: if moving all poses alike changes no error, H annihilates that motion. In the spatial frame the motion
moves all poses by the same δ and block rows sum to zero. In the body frame the same motion is Ad(p_i⁻¹) δ,
different at every vertex, and the rows do not sum to zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from pgti_gtsam.checks import instance, shown, whole
from pgti_gtsam.diffusion.linearisation import Frame, Linearisation
from pgti_gtsam.errors import InvalidGraphError

LARGEST_ELIMINATED = 3000
"""Columns of one connected group of eliminated variables, which is decomposed as a dense matrix."""

ROUNDING = 1e-13
"""What marginalising leaves of a diagonal entry below this share of the entry is rounding: nothing holds that
direction."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NormalEquations:
    """H δ = −g of the poses: half the quadratic model is ½ δᵀHδ + gᵀδ + constant.

    Attributes
    ----------
    hessian : (n d, n d) sparse
        H = JᵀΩJ, other variables marginalised.
    gradient : (n d,) float
        g = JᵀΩe.
    constant : float
        Half the squared error at δ = 0, with other variables at their best.
    dimension : int
        d.
    frame : {"body", "spatial"}
    jacobian, residual : (m, n d) sparse, (m,) float, or None
        J and e where nothing was marginalised: JᵀΩ(e + Jδ) has twice the digits that H δ + g has.
    """

    hessian: sparse.csr_array
    gradient: NDArray[np.float64]
    constant: float
    dimension: int
    frame: Frame
    jacobian: sparse.csr_array | None = None
    residual: NDArray[np.float64] | None = None

    @property
    def n_vertices(self) -> int:
        """Number of poses n."""
        return len(self.gradient) // self.dimension

    def gradient_at(self, delta: NDArray[np.float64]) -> NDArray[np.float64]:
        """H δ + g, (n d,): minus the velocity of the heat flow."""
        if self.jacobian is None or self.residual is None:
            return np.asarray(self.hessian @ delta + self.gradient)
        return np.asarray(self.jacobian.T @ (self.jacobian @ delta + self.residual))


def normal_equations(linearisation: Linearisation) -> NormalEquations:
    """Normal equations of the poses; all other variables are marginalised.

    H = H_pp − H_pl H_ll⁺ H_lp, g = g_p − H_pl H_ll⁺ g_l, the Schur complement. The pseudo-inverse is exact
    for directions that the factors leave open (a landmark with a single bearing), since H_lp has no share there.

    Effect on the Laplacian: block rows still sum to zero in the spatial frame, because moving the whole map
    still changes no error. All poses that saw a landmark become neighbours of each other. The off-diagonal blocks
    are symmetric positive semidefinite "conductances" for factors between poses, and are no longer so in general
    after marginalising (`weight_asymmetry`).

    Raises
    ------
    InvalidGraphError
        The variables to eliminate hang together in a group of more than `LARGEST_ELIMINATED` columns.
    InvalidOptionError
        No linearisation.
    """
    instance(linearisation, Linearisation, "a linearisation")

    # of the poses
    jacobian, residual, n_poses = linearisation.jacobian, linearisation.residual, linearisation.n_pose_columns
    poses, others = jacobian[:, :n_poses], jacobian[:, n_poses:]
    alone = not others.shape[1]
    hessian, gradient, constant = poses.T @ poses, poses.T @ residual, 0.5 * float(residual @ residual)

    # less what the other variables take up
    if not alone:
        eliminated = _block_pseudo_inverse(sparse.csr_array(others.T @ others))
        coupling, right = poses.T @ others, others.T @ residual
        before = hessian.diagonal()
        hessian = hessian - coupling @ eliminated @ coupling.T
        held = sparse.diags_array((hessian.diagonal() > ROUNDING * before).astype(float))
        hessian, gradient = held @ hessian @ held, held @ (gradient - coupling @ (eliminated @ right))
        constant -= 0.5 * float(right @ (eliminated @ right))
    hessian = sparse.csr_array(0.5 * (hessian + hessian.T))
    return NormalEquations(
        hessian=hessian,
        gradient=np.asarray(gradient),
        constant=constant,
        dimension=linearisation.dimension,
        frame=linearisation.frame,
        jacobian=sparse.csr_array(poses) if alone else None,
        residual=residual if alone else None,
    )


def _block_pseudo_inverse(matrix: sparse.csr_array) -> sparse.csr_array:
    """Pseudo-inverse of a symmetric positive semidefinite matrix, connected group by group."""
    # connected groups
    _, labels = csgraph.connected_components(matrix, directed=False)
    order = np.argsort(labels, kind="stable")
    sizes = np.bincount(labels)
    if sizes.max() > LARGEST_ELIMINATED:
        raise InvalidGraphError(
            f"expected other variables in groups of at most {LARGEST_ELIMINATED} dimensions, got {sizes.max()}; "
            "marginalise them before, or leave their factors out"
        )

    # all groups of a size at once, as a stack of dense matrices
    permuted, starts = matrix[order][:, order], np.cumsum(sizes) - sizes
    coo = sparse.coo_array(permuted)
    rows, columns, entries = [], [], []
    for size in np.unique(sizes):
        chosen = np.flatnonzero(sizes == size)
        place = np.full(len(sizes), -1)
        place[chosen] = np.arange(len(chosen))
        group = labels[order][coo.row]
        mine = place[group] >= 0
        dense = np.zeros((len(chosen), size, size))
        first = starts[group[mine]]
        dense[place[group[mine]], coo.row[mine] - first, coo.col[mine] - first] = coo.data[mine]
        within = np.indices((size, size))
        rows.append(order[(starts[chosen][:, None, None] + within[0])].ravel())
        columns.append(order[(starts[chosen][:, None, None] + within[1])].ravel())
        entries.append(np.linalg.pinv(dense, rcond=1e-12, hermitian=True).ravel())

    # back to the order of the variables
    parts = [np.concatenate(part) for part in (entries, rows, columns)]
    return sparse.coo_array((parts[0], (parts[1], parts[2])), shape=matrix.shape).tocsr()


def checked_blocks(matrix: sparse.csr_array, dimension: int) -> sparse.csr_array:
    """A sparse matrix of d × d blocks, checked.

    Parameters
    ----------
    matrix : sparse.csr_array
        (n d, n d).
    dimension : int
        d.

    Raises
    ------
    InvalidGraphError, InvalidOptionError
        Another type, size or dimension, or entries that are not finite.
    """
    d = whole(dimension, "the dimension of a block", least=1)
    if not sparse.issparse(matrix):
        raise InvalidGraphError(f"expected a sparse matrix, got {shown(matrix)}")
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or not matrix.shape[0] or matrix.shape[0] % d:
        raise InvalidGraphError(f"expected a square matrix of {d} × {d} blocks, got one of shape {matrix.shape}")
    if matrix.dtype.kind not in "iuf" or not np.isfinite(matrix.data).all():
        raise InvalidGraphError(f"expected a matrix of finite real numbers, got another of {matrix.dtype}")
    return sparse.csr_array(matrix)


def row_defects(equations: NormalEquations) -> NDArray[np.float64]:
    """How far each block row is from summing to zero, without units, (n,).

    max over a, b of |Σ_j H_ij|_ab / √((H_ii)_aa (H_ii)_bb). Rows and columns are compared with their own diagonal
    entries, so radians and metres do not mix, and another unit of either changes nothing; nor does a distant
    origin, which makes the rotational entries of the spatial frame large. Zero at the vertices of a block
    Laplacian, 1 at a vertex that only a prior ties, zero at a vertex without a factor.
    """
    instance(equations, NormalEquations, "equations")
    n, d = equations.n_vertices, equations.dimension
    sums = np.asarray(equations.hessian @ np.tile(np.eye(d), (n, 1))).reshape(n, d, d)
    scale = np.sqrt(np.maximum(equations.hessian.diagonal(), 0.0)).reshape(n, d)
    allowed = scale[:, :, None] * scale[:, None, :]
    defects: NDArray[np.float64] = np.divide(np.abs(sums), allowed, out=np.zeros_like(sums), where=allowed > 0).max(
        axis=(1, 2)
    )
    return defects


def laplacian_defect(equations: NormalEquations) -> float:
    """Largest of `row_defects`: zero, up to rounding, if and only if H is a block Laplacian."""
    return float(row_defects(equations).max())


def weight_asymmetry(equations: NormalEquations) -> float:
    """Largest |H_ij − H_ijᵀ| of any off-diagonal block, relative to the same scale as `row_defects`.

    Between factors give −H_ij = Bᵀ Ω B in the spatial frame: a symmetric positive semidefinite conductance,
    and zero here. In the body frame, and behind a marginalised landmark, the block is in general no
    conductance at all.
    """
    instance(equations, NormalEquations, "equations")
    n, d = equations.n_vertices, equations.dimension
    blocks = sparse.bsr_array(equations.hessian, blocksize=(d, d))
    rows = np.repeat(np.arange(n), np.diff(blocks.indptr))
    scale = np.sqrt(np.maximum(equations.hessian.diagonal(), 0.0)).reshape(n, d)
    allowed = scale[rows][:, :, None] * scale[blocks.indices][:, None, :]
    allowed = np.maximum(allowed, allowed.transpose(0, 2, 1))
    skew = np.abs(blocks.data - blocks.data.transpose(0, 2, 1))
    parts = np.divide(skew, allowed, out=np.zeros_like(skew), where=allowed > 0)
    return float(parts[rows != blocks.indices].max(initial=0.0))
