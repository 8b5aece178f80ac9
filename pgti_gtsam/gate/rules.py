"""The gate's options and rules: what speaks against a closure, in words."""

from __future__ import annotations

from dataclasses import dataclass

from scipy import stats

from pgti_gtsam.adapter import MIN_SHARED_LANDMARKS
from pgti_gtsam.errors import InvalidOptionError
from pgti_gtsam.gate.evidence import Change, Evidence
from pgti_gtsam.pose_graph import key_label

RULES = ("free_space", "global_rise")

WORTH_TELLING = 0.2
"""Share of its limit from which a witness is quoted: one of three that together pass one has a third or more."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GateOptions:
    """What the gate weighs, and how much of it is too much.

    Attributes
    ----------
    rule : {"free_space", "global_rise"}
        The default sums up what each of the three limits below is used up by, and rejects a closure when
        the sum, its doubt, exceeds one: three witnesses, none of whom must be sure alone. The other is
        the paper's rule (section 6.3.1) on its own: reject when Λ_glob rises by more than its limit.
        In the experiments on KITTI, scan graphs and streets true closures had a doubt of 0.9 at most, false
        ones of 1.4 or more, but for seven of KITTI that name a place within drift of the right one.
    max_local_rise : float
        Largest rise of any keyframe's own stable score. First contacts of true closures raised it by up
        to 0.26, a floor laid upon another by 0.63 or more, where no other witness speaks.
    max_strain : float
        Largest rise of the largest closure residual, in ρ: a relative pose that is off by more than half
        the free radius names another place.
    max_bending : float
        Largest bending, in the yardstick's tolerances. True closures reached 1.9 in rooms and 0.8 on streets;
        most false ones lie far beyond 3, and those below it show in the local score as well.
    max_global_rise : float
        Of the paper's rule, which names no number: 0.2 as in most of the experiments; no value parts true from false.
    chi2_confidence : float or None
        When given, also reject a closure whose rise of χ² is beyond this quantile: only as good as
        the noise models are.
    beta : float
        β of Λ_loc and Λ_glob.
    edges, min_shared_landmarks
        As in `from_gtsam`.
    """

    rule: str = "free_space"
    max_local_rise: float = 0.5
    max_strain: float = 0.5
    max_bending: float = 2.5
    max_global_rise: float = 0.2
    chi2_confidence: float | None = None
    beta: float = 0.5
    edges: tuple[str, ...] | None = None
    min_shared_landmarks: int = MIN_SHARED_LANDMARKS

    def __post_init__(self) -> None:
        if self.rule not in RULES:
            raise InvalidOptionError(f"expected rule from {', '.join(RULES)}, got {self.rule!r}")
        for name in ("max_local_rise", "max_strain", "max_bending", "max_global_rise"):
            if not getattr(self, name) > 0:
                raise InvalidOptionError(f"expected {name} above 0, got {getattr(self, name)}")
        for name in ("beta", "chi2_confidence"):
            share = getattr(self, name)
            if share is not None and not 0 < share < 1:
                raise InvalidOptionError(f"expected {name} between 0 and 1, got {share}")


def doubts(evidence: Evidence, options: GateOptions) -> dict[str, float]:
    """Share of its limit that each witness uses up, zero or more: a closure's doubt is their sum."""
    return {
        "bending": evidence.bending / options.max_bending,
        "local_rise": max(evidence.local_score.rise, 0.0) / options.max_local_rise,
        "strain": max(evidence.strain.rise, 0.0) / options.max_strain,
    }


def doubt(evidence: Evidence, options: GateOptions) -> float:
    """What speaks against a closure, all in all: rejected beyond one."""
    return sum(doubts(evidence, options).values())


def hopeless(bending: float, options: GateOptions) -> bool:
    """Whether the bending alone condemns a closure."""
    return bending > options.max_bending


def bending_objection(bending: float, options: GateOptions) -> str:
    """What the bending says."""
    return (
        f"the map would have to bend {bending:.2g} times as far as poor odometry drifts (limit {options.max_bending:g})"
    )


def free_space_objections(evidence: Evidence, options: GateOptions) -> list[str]:
    """What each witness says, the gravest first, when together they leave too much doubt."""
    shares = doubts(evidence, options)
    if doubt(evidence, options) <= 1:
        return []
    score, strain = evidence.local_score, evidence.strain
    where = "none" if evidence.worst_key is None else key_label(evidence.worst_key)
    said = {
        "bending": bending_objection(evidence.bending, options),
        "local_rise": f"free space around {where} comes to touch places that nothing connects: its score "
        f"rises from {score.before:.2f} to {score.after:.2f} (limit +{options.max_local_rise:g})",
        "strain": f"closures would miss by {strain.after * evidence.unit_m:.2f} m: {strain.after:.2g} of the free "
        f"radius, {strain.before:.2g} before (limit +{options.max_strain:g})",
    }
    gravest = sorted(shares, key=lambda name: -shares[name])
    return [said[name] for name in gravest if shares[name] >= WORTH_TELLING]


def global_rise_objections(change: Change, options: GateOptions) -> list[str]:
    """The paper's rule: Λ_glob before and after."""
    if change.rise <= options.max_global_rise:
        return []
    return [f"Λ_glob rises at once from {change.before:.2f} to {change.after:.2f} (limit +{options.max_global_rise:g})"]


def chi2_objections(evidence: Evidence, confidence: float) -> list[str]:
    """A rise of χ² beyond a quantile."""
    limit = float(stats.chi2.ppf(confidence, evidence.chi2_dof))
    if evidence.chi2.rise <= limit:
        return []
    return [
        f"χ² rises by {evidence.chi2.rise:.3g}, beyond the {confidence:g} quantile {limit:.3g} of "
        f"{evidence.chi2_dof} degrees of freedom"
    ]


def no_objection(evidence: Evidence) -> str:
    """Why a closure passes, in one sentence."""
    if evidence.worst_key is None:
        return f"it changes no contact, and bends the map by {evidence.bending:.2g} of what poor odometry drifts"
    return (
        f"unexplained overlaps go from {evidence.overlaps.before:.0f} to {evidence.overlaps.after:.0f}, and the map "
        f"bends by {evidence.bending:.2g} of what poor odometry drifts"
    )
