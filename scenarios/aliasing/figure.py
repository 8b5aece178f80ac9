"""F1 against what methods are told of the noise, and against the share of false closures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt

from scenarios import aliasing
from scenarios.aliasing import methods, streets


def draw(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Draw both, with intervals over seeds."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(12, 4.4), layout="constrained", sharey=True)
    for k, method in enumerate(methods.METHODS):
        style = {"color": f"C{k % 10}", "lw": 2.4 if method == "gate" else 1.0, "ls": "-" if k < 6 else "--"}
        by_told = [_f1(rows, method, told, 1.0) for told in streets.TOLD]
        by_share = [_f1(rows, method, "right", share) for share in aliasing.SHARES]
        for axis, places, found in (
            (left, np.arange(len(by_told)) + 0.02 * k, by_told),
            (right, aliasing.SHARES, by_share),
        ):
            mean, low, high = np.array(found).T
            axis.errorbar(places, mean, [mean - low, high - mean], label=method, capsize=2, elinewidth=0.6, **style)
    left.set_xticks(range(len(streets.TOLD)), streets.TOLD)
    left.set(xlabel="sigmas that methods are told", ylabel="F1 of accepted true closures", ylim=(0, 1.05))
    right.set(xlabel="false closures per true one, right sigmas")
    right.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _f1(rows: Sequence[dict[str, Any]], method: str, told: str, share: float) -> tuple[float, float, float]:
    wanted = (method, told, share)
    return aliasing.mean_and_interval([r["f1"] for r in rows if (r["method"], r["told"], r["share"]) == wanted])
