"""A factor graph linearised at its values: the whitened Jacobian as a sparse matrix, in two frames.

GTSAM perturbs a pose from the right, p Exp(δ_body): the body frame. The paper's Eq. 10 perturbs a pose from the left,
Exp(δ_space) p: the spatial frame. Both say the same with δ_body = Ad(p⁻¹) δ_space, so the spatial Jacobian
is the body's times the block diagonal of the Ad(p_i⁻¹). Rows are whitened as in GTSAM: JᵀJ here is
the paper's JᵀΩJ. A robust loss multiplies the rows of the factor by the root of the present weight, which
scales that factor's Ω and nothing else.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from pgti_gtsam.checks import instance
from pgti_gtsam.errors import (
    InvalidGraphError,
    InvalidValueError,
    MissingValueError,
    NoPoseError,
    UnsolvableGraphError,
)
from pgti_gtsam.factor_graphs import check_map, slots_of

Frame = Literal["body", "spatial"]

GROUPS = {"Pose2": gtsam.Pose2, "Pose3": gtsam.Pose3, "Similarity3": gtsam.Similarity3}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Linearisation:
    """Factors linearised at a value of every variable: e(δ) = e + J δ.

    Attributes
    ----------
    group : str
        Type of the poses: "Pose2", "Pose3" or "Similarity3", of dimension d = 3, 6 or 7.
    frame : {"body", "spatial"}
    keys : (n,) uint64
        The poses, ascending; pose i owns columns i d to (i + 1) d.
    other_keys, other_starts : (k,) uint64, (k + 1,) int
        All other variables (landmarks, velocities, ...) and their first columns, behind the columns of the poses.
    jacobian : (m, n d + ...) sparse
        Whitened.
    residual : (m,) float
        Whitened error e of every row.
    row_slots : (m,) int
        Slot of the factor that each row belongs to.
    adjoints : (n, d, d) float
        Ad(p_i⁻¹).
    """

    group: str
    frame: Frame
    keys: NDArray[np.uint64]
    other_keys: NDArray[np.uint64]
    other_starts: NDArray[np.int64]
    jacobian: sparse.csr_array
    residual: NDArray[np.float64]
    row_slots: NDArray[np.int64]
    adjoints: NDArray[np.float64]

    @property
    def dimension(self) -> int:
        """d, the dimension of a pose."""
        return int(self.adjoints.shape[-1])

    @property
    def n_pose_columns(self) -> int:
        """Columns that belong to poses, n d."""
        return len(self.keys) * self.dimension

    @property
    def labels(self) -> list[str]:
        """Names of the poses, as GTSAM writes keys."""
        return [gtsam.DefaultKeyFormatter(key) for key in self.keys.tolist()]


def linearise(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> Linearisation:
    """Linearise a factor graph in GTSAM's own, the body frame. Graph and values stay untouched.

    Keyframes are the poses of one group; every other variable follows behind, to be marginalised
    (`normal_equations`). Empty slots are passed over.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values

    Raises
    ------
    NoPoseError
        No value is a Pose2, Pose3 or Similarity3.
    InvalidValueError
        Poses of more than one type, or a factor whose linearisation is not finite.
    MissingValueError
        A factor's key has no value.
    InvalidGraphError
        The graph holds no factor.
    UnsolvableGraphError
        A hard constraint (infinite conductance, no finite flow), or a factor that GTSAM
        cannot linearise.
    """
    check_map(graph, values)
    group, keys, adjoints = _poses(values)
    d = adjoints.shape[-1]
    dims = dimensions(values)
    others = sorted(set(dims) - set(keys))
    starts = len(keys) * d + np.concatenate([[0], np.cumsum([dims[key] for key in others])]).astype(np.int64)
    column = {key: i * d for i, key in enumerate(keys)} | dict(zip(others, starts.tolist(), strict=False))

    # each factor where its variables stand
    blocks = [(slot, *linearised(slot, factor, values, dims)) for slot, factor in slots_of(graph)]
    if not blocks:
        raise InvalidGraphError(
            "expected a graph with factors, got none: there is nothing that heat could pass through"
        )
    return Linearisation(
        group=group,
        frame="body",
        keys=np.array(keys, dtype=np.uint64),
        other_keys=np.array(others, dtype=np.uint64),
        other_starts=starts,
        jacobian=_stacked(blocks, column, dims, int(starts[-1])),
        residual=np.concatenate([residual for *_, residual in blocks]),
        row_slots=np.repeat([slot for slot, *_ in blocks], [len(residual) for *_, residual in blocks]),
        adjoints=adjoints,
    )


def in_space(body: Linearisation) -> Linearisation:
    """The same factors with every pose perturbed from the left: J Ad(p⁻¹) in its columns. Other variables stay."""
    if instance(body, Linearisation, "a linearisation").frame == "spatial":
        return body
    return replace(body, frame="spatial", jacobian=sparse.csr_array(body.jacobian @ to_body(body)))


def to_body(linearisation: Linearisation) -> sparse.csr_array:
    """Block diagonal of the Ad(p_i⁻¹), with 1 for other variables: δ_body = T δ_space, square."""
    instance(linearisation, Linearisation, "a linearisation")
    n, d, n_columns = len(linearisation.keys), linearisation.dimension, linearisation.jacobian.shape[1]
    blocks = sparse.bsr_array((linearisation.adjoints, np.arange(n), np.arange(n + 1)), shape=(n * d, n * d))
    return sparse.csr_array(sparse.block_diag([blocks, sparse.eye_array(n_columns - n * d)], format="csr"))


def _poses(values: gtsam.Values) -> tuple[str, list[int], NDArray[np.float64]]:
    """Group, keys and adjoint maps of the inverse poses."""
    found = {name: _of_group(values, name) for name in GROUPS}
    present = [name for name, poses in found.items() if poses]
    if not present:
        raise NoPoseError(
            f"expected poses among the values, got {values.size()} values of which none is a Pose2, "
            "Pose3 or Similarity3; "
            "other pose types are not supported here"
        )
    if len(present) > 1:
        raise InvalidValueError(f"expected poses of one group, got {' and '.join(present)}; split the graph")
    poses = found[present[0]]
    adjoints = np.array([pose.inverse().AdjointMap() for pose in poses.values()])
    finite = np.isfinite(adjoints).all(axis=(1, 2))
    if not finite.all():
        key = list(poses)[int(np.argmin(finite))]
        raise InvalidValueError(f"expected finite poses, got another at {gtsam.DefaultKeyFormatter(key)}")
    return present[0], list(poses), adjoints


def _of_group(values: gtsam.Values, name: str) -> dict[int, Any]:
    if name == "Similarity3":
        sevens = sorted(int(key) for key, size in values.dims().items() if size == 7)
        return {key: pose for key in sevens if (pose := _similarity(values, key)) is not None}
    chosen = gtsam.utilities.allPose2s(values) if name == "Pose2" else gtsam.utilities.allPose3s(values)
    at: Any = getattr(chosen, f"at{name}")
    return {key: at(key) for key in sorted(chosen.keys())}


def _similarity(values: gtsam.Values, key: int) -> gtsam.Similarity3 | None:
    try:
        return values.atSimilarity3(key)
    except RuntimeError:
        return None


def dimensions(values: gtsam.Values) -> dict[int, int]:
    """Dimension of every value, by key."""
    return {int(key): int(size) for key, size in values.dims().items()}


def linearised(
    slot: int, factor: Any, values: gtsam.Values, dims: dict[int, int]
) -> tuple[list[int], NDArray[np.float64], NDArray[np.float64]]:
    """Keys, whitened Jacobian and whitened error of a factor; empty where the factor is inactive.

    Parameters
    ----------
    slot : int
    factor : gtsam.NonlinearFactor
    values : gtsam.Values
    dims : dict of int to int
        `dimensions` of the values.

    Raises
    ------
    MissingValueError, InvalidValueError, UnsolvableGraphError
        Those of `linearise`.
    """
    # a value of every key
    named = f"{type(factor).__name__} in slot {slot}"
    for key in factor.keys():  # noqa: SIM118
        if key not in dims:
            raise MissingValueError(
                f"expected a value of every key, got none of {gtsam.DefaultKeyFormatter(key)} of {named}"
            )

    # GTSAM's linearisation, refused where it fails or is constrained
    try:
        linear = factor.linearize(values)
        if linear is None:
            return [], np.zeros((0, 0)), np.zeros(0)
        if isinstance(linear, gtsam.JacobianFactor) and linear.isConstrained():
            raise UnsolvableGraphError(
                f"expected factors of finite information, got the hard constraint {named}; "
                "give it a small sigma instead"
            )
        matrix, right = linear.jacobian()
    except (RuntimeError, ValueError, IndexError) as error:
        raise UnsolvableGraphError(
            f"expected factors that GTSAM can linearise, got {named}: {_first_line(error)}"
        ) from error

    # finite numbers
    if not (np.isfinite(matrix).all() and np.isfinite(right).all()):
        raise InvalidValueError(f"expected factors of finite error and Jacobian, got another in {named}")
    return list(linear.keys()), matrix, -right


def _first_line(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0]


def _stacked(
    blocks: list[tuple[int, list[int], NDArray[np.float64], NDArray[np.float64]]],
    column: dict[int, int],
    dims: dict[int, int],
    n_columns: int,
) -> sparse.csr_array:
    """All factors' Jacobians below each other, with the columns that `column` says."""
    rows, columns, entries, start = [], [], [], 0
    for _, keys, matrix, _ in blocks:
        if not keys:
            continue
        own = np.concatenate([np.arange(column[key], column[key] + dims[key]) for key in keys])
        rows.append(np.repeat(np.arange(start, start + len(matrix)), len(own)))
        columns.append(np.tile(own, len(matrix)))
        entries.append(matrix.ravel())
        start += len(matrix)
    parts = [np.concatenate(part) if part else np.zeros(0) for part in (entries, rows, columns)]
    return sparse.coo_array((parts[0], (parts[1], parts[2])), shape=(start, n_columns)).tocsr()


def robust_weights(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> dict[int, float]:
    """Present weight of every factor with a robust loss, by slot: the factor's conductance is that share of the
    noise model says.

    Weights belong to the values; weights change as the flow goes on, and the linearised flow does not follow.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
        An estimate of all variables.

    Raises
    ------
    PgtiError
        Those of `linearise`.
    """
    check_map(graph, values)
    weights, dims = {}, dimensions(values)
    for slot, factor in slots_of(graph):
        model = factor.noiseModel() if hasattr(factor, "noiseModel") else None
        if isinstance(model, gtsam.noiseModel.Robust):
            linearised(slot, factor, values, dims)
            whitened = model.noise().whiten(factor.unwhitenedError(values))
            loss: Any = model.robust()
            weights[slot] = float(loss.weight(float(np.linalg.norm(whitened))))
    return weights
