"""Pose-graph optimisation seen as heat diffusion (section 4 of the paper, Eq. 8 to 12).

`linearise` stacks the Jacobian of a factor graph in GTSAM's frame, `in_space` in the paper's;
`normal_equations` gives H and g; `row_defects` measures how far H is from a block Laplacian;
`heat_flow` follows dδ/dt = −Hδ − g; `compare` asks how well PGTI's scalar Laplacian stands for H; `study`
runs all of these.
"""

from pgti_gtsam.diffusion.block_laplacian import (
    NormalEquations,
    laplacian_defect,
    normal_equations,
    row_defects,
    weight_asymmetry,
)
from pgti_gtsam.diffusion.flow import (
    HeatFlow,
    extreme_eigenvalues,
    heat_flow,
    relative_consensus,
    steady_state,
    unforced,
)
from pgti_gtsam.diffusion.grounding import Ground, components, grounded, grounded_graph, grounds
from pgti_gtsam.diffusion.jacobians import Equation11, equation_11, inverse_right_jacobian
from pgti_gtsam.diffusion.linearisation import Linearisation, in_space, linearise, robust_weights, to_body
from pgti_gtsam.diffusion.optimisers import (
    OPTIMISERS,
    Step,
    gauss_newton_poses,
    gradient_descent,
    gtsam_steps,
    matched_time,
    moved,
    relinearised_flow,
    steady_state_error,
    updates,
)
from pgti_gtsam.diffusion.proxy import Proxy, block_edges, compare, heat_left, information_weights, spearman
from pgti_gtsam.diffusion.spread import Spread, hops_from, spread
from pgti_gtsam.diffusion.study import Study, scalar_equations, study, time_grid

__all__ = [
    "OPTIMISERS",
    "Equation11",
    "Ground",
    "HeatFlow",
    "Linearisation",
    "NormalEquations",
    "Proxy",
    "Spread",
    "Step",
    "Study",
    "block_edges",
    "compare",
    "components",
    "equation_11",
    "extreme_eigenvalues",
    "gauss_newton_poses",
    "gradient_descent",
    "grounded",
    "grounded_graph",
    "grounds",
    "gtsam_steps",
    "heat_flow",
    "heat_left",
    "hops_from",
    "in_space",
    "information_weights",
    "inverse_right_jacobian",
    "laplacian_defect",
    "linearise",
    "matched_time",
    "moved",
    "normal_equations",
    "relative_consensus",
    "relinearised_flow",
    "robust_weights",
    "row_defects",
    "scalar_equations",
    "spearman",
    "spread",
    "steady_state",
    "steady_state_error",
    "study",
    "time_grid",
    "to_body",
    "unforced",
    "updates",
    "weight_asymmetry",
]
