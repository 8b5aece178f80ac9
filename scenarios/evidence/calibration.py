"""Of closures that the gate calls 80 % probable, are 80 % true? On seeds that no constant was chosen on.

Ray-cast worlds, asked all at once as `gate_graph` does and revisit by revisit in time order, and standard graphs with
outliers. A temperature T, a divisor of the log odds, is fitted on training seeds; whether T helps is seen on
the held-out seeds.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib import pyplot as plt
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.special import expit
from scipy.stats import beta

import pgti_gtsam as pgti
from pgti_gtsam import outputs
from scenarios import near_misses, worlds
from scenarios.aliasing import field, methods
from scenarios.evidence.rise_fit import arrivals
from scenarios.problem import Problem
from scenarios.worlds.layouts import LAYOUTS
from scenarios.worlds.solid import Array

BINS = 10

AT_ONCE, IN_TIME = "at once", "in time"


class Trial(NamedTuple):
    """A world of `LAYOUTS` or the path of a standard graph, a seed, the order of asking or the outliers' pattern."""

    world: str
    seed: int
    setting: str

    def key(self) -> Trial:
        """The trial under the name in its row, wherever the data lies."""
        return self._replace(world=Path(self.world).stem)


def trials(names: Sequence[str], seeds: Sequence[int], graphs: Sequence[Path] = ()) -> Iterator[Trial]:
    """Both orders of every drive; every kind of outlier in standard graphs, as many as inliers; labelled real loops.

    Parameters
    ----------
    names : sequence of str
        Worlds.
    seeds : sequence of int
    graphs : sequence of Path
        Standard graphs.
    """
    orders, kinds = (AT_ONCE, IN_TIME), field.KINDS
    yield from (Trial(world, seed, order) for seed, world, order in product(seeds, names, orders))
    for path in graphs:
        if path.name == near_misses.GRAPH:
            yield from (Trial(str(path), 0, f"{radius:g} m") for radius in near_misses.RADII_M)
        else:
            yield from (Trial(str(path), seed, kind) for seed, kind in product(seeds, kinds))


def row(trial: Trial) -> dict[str, Any]:
    """Log odds of every closure that something judges, and whether the closure is true."""
    if trial.world in LAYOUTS:
        given = worlds.problem(trial.world, trial.seed)
        found = at_once(given) if trial.setting == AT_ONCE else in_time(given)
    elif trial.setting in field.KINDS:
        found = at_once(field.problem(Path(trial.world), trial.seed, 1.0, trial.setting))
    else:
        found = labelled(near_misses.loops(Path(trial.world).parent), float(trial.setting.removesuffix(" m")))
    known = [(round(odds, 4), is_true) for odds, is_true in found if not np.isnan(odds)]
    return trial.key()._asdict() | {"judged": known, "unjudged": len(found) - len(known)}


def at_once(given: Problem) -> list[tuple[float, bool]]:
    """All closures through the gate together."""
    graph = methods.joined(given, np.ones(len(given.closures), dtype=bool))
    slots = range(given.graph.size(), graph.size())
    decided = pgti.gate_graph(graph, given.values, given.radii, closures=slots).decisions
    return [(decided[slot].log_odds, bool(is_true)) for slot, is_true in zip(slots, given.true, strict=True)]


def in_time(given: Problem) -> list[tuple[float, bool]]:
    """Every revisit in time order, onto a map of all earlier true closures."""
    gate = pgti.LoopClosureGate()
    return [
        (decision.log_odds, is_true)
        for arrival in arrivals(given, gate)
        for decision, is_true in zip(
            gate.judge(arrival.reference, arrival.closures).decisions, arrival.true, strict=True
        )
    ]


def labelled(given: near_misses.Loops, radius_m: float) -> list[tuple[float, bool]]:
    """Real loops, together.

    Parameters
    ----------
    given : near_misses.Loops
    radius_m : float
        Free radius, m.
    """
    slots = given.slots.tolist()
    decided = pgti.gate_graph(given.graph, given.values, radius_m, closures=slots).decisions
    return [(decided[slot].log_odds, is_true) for slot, is_true in zip(slots, given.true.tolist(), strict=True)]


def gathered(rows: Sequence[dict[str, Any]]) -> tuple[Array, NDArray[np.bool_]]:
    """Log odds and truth of all rows, (k,) each."""
    judged = np.array([each for row in rows for each in row["judged"]], dtype=float).reshape(-1, 2)
    return judged[:, 0], judged[:, 1] > 0


def temperature(log_odds: Array, true: NDArray[np.bool_]) -> float:
    """T that makes log odds / T most likely.

    Parameters
    ----------
    log_odds : (k,) float
    true : (k,) bool
    """

    def misfit(log_t: float) -> float:
        scaled = log_odds * np.exp(-log_t)
        return float((np.logaddexp(0.0, scaled) - true * scaled).sum())

    return float(np.exp(minimize_scalar(misfit, bounds=(-3.0, 3.0), method="bounded").x))


def calibration_error(probability: Array, true: NDArray[np.bool_], *, equal_mass: bool) -> float:
    """Mean distance between probability and share of true closures in ten bins (Naeini et al., AAAI 2015).

    Parameters
    ----------
    probability : (k,) float
    true : (k,) bool
    equal_mass : bool
        Bins of equally many closures, not of equal width.
    """
    inside = bins(probability, equal_mass=equal_mass)
    gaps = [abs(probability[own].mean() - true[own].mean()) * own.sum() for own in inside if own.any()]
    return float(sum(gaps) / len(probability))


def bins(probability: Array, *, equal_mass: bool) -> list[NDArray[np.bool_]]:
    """The members of each bin of probabilities.

    Parameters
    ----------
    probability : (k,) float
    equal_mass : bool
        Bins of equally many, not of equal width.
    """
    place = np.minimum((BINS * probability).astype(int), BINS - 1)
    if equal_mass:
        place = BINS * np.argsort(np.argsort(probability, kind="stable")) // len(probability)
    return [place == k for k in range(BINS)]


def report(held_out: Sequence[dict[str, Any]], training: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Expected calibration error by kind of case, with and without a temperature, and the shares by probability.

    Parameters
    ----------
    held_out : sequence of mapping
        Rows of held-out seeds.
    training : sequence of mapping
        Rows of training seeds.
    """
    t = temperature(*gathered(training))
    yield f"temperature of {len(gathered(training)[0])} closures of training seeds: {t:.2f}\n"
    head = "ECE, equal mass | equal width"
    yield f"| cases | closures | true | {head} | at T = {t:.2f}: {head} | accepted false | rejected true |"
    yield "|---|" + "---|" * 8
    for name, rows in _kinds(held_out):
        odds, true = gathered(rows)
        errors = [calibration_error(expit(o), true, equal_mass=m) for o in (odds, odds / t) for m in (True, False)]
        sure = [int((~true & (odds > np.log(19))).sum()), int((true & (odds < -np.log(19))).sum())]
        cells = [len(odds), true.sum(), *(f"{error:.3f}" for error in errors), *sure]
        yield f"| {name} | " + " | ".join(map(str, cells)) + " |"
    yield "\n| probability | closures | mean probability | true |\n|---|---|---|---|"
    odds, true = gathered(held_out)
    told = expit(odds)
    for k, own in enumerate(bins(told, equal_mass=False)):
        if own.any():
            mean, share = told[own].mean(), true[own].mean()
            yield f"| {k / BINS:g} to {(k + 1) / BINS:g} | {own.sum()} | {mean:.3f} | {share:.3f} |"


def draw(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Share of true closures against probability, of all with 95 % intervals, and the number in each bin.

    Parameters
    ----------
    rows : sequence of mapping
    path : Path
    """
    # shares in bins, worlds with intervals
    figure, (above, below) = plt.subplots(
        2, 1, figsize=(6.8, 6.0), layout="constrained", sharex=True, height_ratios=[3, 1]
    )
    above.plot([0, 1], [0, 1], color="grey", lw=0.8)
    for k, (name, own) in enumerate(_kinds(rows)):
        odds, true = gathered(own)
        inside = bins(told := expit(odds), equal_mass=False)
        there = [each for each in inside if each.any()]
        mean, share = np.array([(told[each].mean(), true[each].mean()) for each in there]).T
        if k:
            above.plot(mean, share, "x", color=f"C{k - 1}", label=name)
            continue
        low, high = np.transpose([_interval(true[each]) for each in there])
        above.errorbar(mean, share, [share - low, high - share], fmt="o", color="black", capsize=3, label=name)
        below.bar((np.arange(BINS) + 0.5) / BINS, [each.sum() for each in inside], 0.09, color="black")

    # axes
    above.set(ylabel="share that is true", ylim=(-0.02, 1.02))
    above.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    below.set(xlabel="decision.probability", ylabel="closures", yscale="log", xlim=(-0.02, 1.02))
    with outputs.drawn(path) as part:
        figure.savefig(part, dpi=110)
    plt.close(figure)


def _kinds(rows: Sequence[dict[str, Any]]) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    """All rows, and the rows of each kind of case."""
    real = [row for row in rows if row["setting"] in field.KINDS]
    near = [row for row in rows if row["setting"].endswith(" m")]
    drawn = [(f"worlds, {o}", [row for row in rows if row["setting"] == o]) for o in (AT_ONCE, IN_TIME)]
    yield "all", list(rows)
    yield from ((name, own) for name, own in [*drawn, ("outliers in real graphs", real), ("real loops", near)] if own)


def _interval(true: NDArray[np.bool_]) -> tuple[float, float]:
    """Clopper-Pearson interval of 95 % of a share."""
    n, k = len(true), int(true.sum())
    low = float(beta.ppf(0.025, k, n - k + 1)) if k else 0.0
    return low, float(beta.ppf(0.975, k + 1, n - k)) if k < n else 1.0
