"""Time and memory against size in double-logarithmic axes, from the benchmark's JSON."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot as plt

from pgti_gtsam import outputs

STYLES = {
    "poles": ("#1b6ca8", "o"),
    "dense": ("#c0392b", "s"),
    "lanczos": ("#7f8c8d", "^"),
    "chebyshev": ("#8e6c8a", "v"),
}
NAMES = {
    "poles": "poles (ours)",
    "dense": "dense eigendecomposition",
    "lanczos": "Lanczos, 300 pairs",
    "chebyshev": "Chebyshev",
}


def draw(found: dict[str, Any], path: Path) -> None:
    """Draw the result of `run`.

    Parameters
    ----------
    found : mapping
    path : Path
    """
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.6), layout="constrained", sharex=True)
    for axis, quantity, unit in zip(
        axes, ("seconds", "peak_megabytes"), ("processor time, s", "peak memory, MB"), strict=True
    ):
        # synthetic graphs
        for (family, line), (solver, (colour, marker)) in (
            (f, s) for f in (("chain", "-"), ("laps", "--")) for s in STYLES.items()
        ):
            points = sorted(
                (row["n_vertices"], row[quantity])
                for row in found["solvers"]
                if row["solver"] == solver and row["case"].startswith(family) and row[quantity] > 0
            )
            if points:
                axis.plot(
                    *zip(*points, strict=True),
                    line,
                    color=colour,
                    marker=marker,
                    ms=4,
                    label=_label(found, family, solver),
                )

        # real graphs
        for solver, (colour, marker) in STYLES.items():
            real = [
                row
                for row in found["solvers"]
                if row["solver"] == solver and row["case"].partition("-")[0] not in ("chain", "laps", "random")
            ]
            axis.scatter(
                [r["n_vertices"] for r in real],
                [r[quantity] for r in real],
                s=30,
                facecolors="none",
                edgecolors=colour,
                marker=marker,
            )

        # axes
        axis.set(xscale="log", yscale="log", xlabel="keyframes", ylabel=unit)
        axis.grid(alpha=0.3, which="both", lw=0.4)
    axes[0].legend(fontsize=7)
    axes[0].set_title("Lines: synthetic chains and laps. Hollow: real pose graphs", fontsize=9)
    with outputs.drawn(path) as part:
        figure.savefig(part, dpi=140)
    plt.close(figure)


def _label(found: dict[str, Any], family: str, solver: str) -> str:
    exponent = found["growth"].get(family) if solver == "poles" else None
    return f"{NAMES[solver]}, {family}" + (f" (exponent {exponent:.2f})" if exponent else "")
