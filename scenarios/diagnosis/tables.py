"""Rows as Markdown: verdicts against the truth, by damage; kinds of places; false closures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from scenarios.diagnosis.damage import ODOMETRY, SCALE
from scenarios.diagnosis.expectation import is_right

EXPECTED = ("consistent", "incomplete", "inconsistent")
VERDICTS = (*EXPECTED, "undecided")

TIED_KINDS = ("missed closure", "untied second pass", "tracking gap")
KINDS = (*TIED_KINDS, "different view", "incomplete fusion", "likely false closure", "undecided contact")
"""Kinds of places; the first ask for a tie."""

Rows = Sequence[dict[str, Any]]


def confusion(rows: Rows) -> str:
    """Right verdicts against given verdicts, and the share right among all."""
    count = Counter((row["expected"], row["verdict"]) for row in known(rows))
    lines = [_line(["right \\ said", *VERDICTS, "right of decided", "right of all"]), _rule(7)]
    for right in EXPECTED:
        own = [row for row in known(rows) if row["expected"] == right]
        lines.append(_line([right, *(count[right, said] for said in VERDICTS), *_shares(own)]))
    return "\n".join([*lines, _line(["all", *(_said(rows, said) for said in VERDICTS), *_shares(known(rows))])])


def by(rows: Rows, name: str) -> str:
    """Shares right by the values of a column, and the confusions.

    Parameters
    ----------
    rows : Rows
    name : str
        Column of the rows.
    """
    lines = [_line([name, "cases", "right of decided", "right of all", "undecided", "wrong: right → said"]), _rule(6)]
    for value in dict.fromkeys(row[name] for row in known(rows)):
        own = [row for row in known(rows) if row[name] == value]
        wrong = Counter(
            f"{row['expected']} → {row['verdict']}"
            for row in own
            if row["verdict"] not in (row["expected"], "undecided")
        )
        told = ", ".join(f"{n} {what}" for what, n in wrong.most_common())
        lines.append(_line([value, len(own), *_shares(own), _said(own, "undecided"), told or "–"]))
    return "\n".join(lines)


def good(rows: Rows) -> str:
    """How often a map with nothing wrong is called inconsistent."""
    own = [row for row in known(rows) if row["damage"] == "nothing" and row["expected"] != "inconsistent"]
    bad = _said(own, "inconsistent")
    apart = sum(row["damage"] == "nothing" for row in known(rows)) - len(own)
    return (
        f"undamaged and right by the truth: {len(own)} maps, {bad} called inconsistent ({_share(bad, len(own))}); "
        f"{apart} more are undamaged, but bring stretches into contact that are apart"
    )


def kinds(rows: Rows) -> str:
    """How often a place's kind is right, by kind (`expectation.is_right`)."""
    heads = ["kind", "places", "contact is real", "could be tied", "kind is right", "kind is wrong", "left open"]
    lines = [_line(heads), _rule(len(heads))]
    for kind in KINDS:
        own = [place for row in known(rows) for place in row["places"] if place[0] == kind]
        real, tied = (sum(place[k] for place in own) for k in (1, 2))
        lines.append(_line([kind, len(own), real, tied, *_judged(own)]))
    return "\n".join(lines)


def untied(rows: Rows) -> str:
    """Maps of odometry alone: what places are called, by world; fusion follows from ties and is left out."""
    heads = ["odometry only", "places", "called second passes", "of these real", "contacts by chance", "called passes"]
    heads += ["kind is right", "kind is wrong", "left open"]
    lines = [_line(heads), _rule(len(heads))]
    alone = [row for row in known(rows) if row["damage"] in (ODOMETRY, SCALE)]
    for world in [*dict.fromkeys(row["world"] for row in alone), "all"]:
        own = [
            place
            for row in alone
            for place in row["places"]
            if world in (row["world"], "all") and place[0] != "incomplete fusion"
        ]
        called, chance = [place for place in own if place[0] in TIED_KINDS], [place for place in own if not place[1]]
        both = sum(place[0] in TIED_KINDS for place in chance)
        lines.append(_line([world, len(own), len(called), len(called) - both, len(chance), both, *_judged(own)]))
    return "\n".join(lines)


def _judged(places: Sequence[Any]) -> list[str | int]:
    """Share of places whose kind is right, of those that are decided; how many are wrong, and left open."""
    found = [is_right(kind, is_real=real, can_be_tied=tied) for kind, real, tied, *_ in places]
    right, wrong = found.count(True), found.count(False)
    return [_share(right, right + wrong), wrong, found.count(None)]


def closures(rows: Rows) -> str:
    """The rank of false closures among a map's closures, and closures called false."""
    heads = ["false closures", "maps", "all of them least probable", "all called false", "true ones called false"]
    lines = [_line(heads), _rule(5)]
    tests: dict[str, Callable[[dict[str, Any]], bool]] = {
        "one, visible": lambda row: len(row["ranks"]) == 1 and row["visible"],
        "one, not visible": lambda row: len(row["ranks"]) == 1 and not row["visible"],
        "several, visible": lambda row: len(row["ranks"]) > 1 and row["visible"],
        "several, not visible": lambda row: len(row["ranks"]) > 1 and not row["visible"],
        "none": lambda row: not row["ranks"],
    }
    for name, test in tests.items():
        own = [row for row in known(rows) if test(row)]
        least = sum(sorted(row["ranks"], key=lambda k: k or 0) == list(range(1, len(row["ranks"]) + 1)) for row in own)
        called = sum(row["false_called"] == len(row["ranks"]) for row in own)
        true, total = sum(row["true_called"] for row in own), sum(row["n_closures"] - len(row["ranks"]) for row in own)
        cells = ["–", "–"] if name == "none" else [_share(least, len(own)), _share(called, len(own))]
        lines.append(_line([name, len(own), *cells, f"{true} of {total}"]))
    return "\n".join(lines)


def report(rows: Rows) -> Iterator[str]:
    """All tables of each kind of map, with a heading each."""
    for variant in dict.fromkeys(row["variant"] for row in rows):
        own = [row for row in rows if row["variant"] == variant]
        yield f"\n{variant}: {len(known(own))} cases, {len(own) - len(known(own))} more came to no end\n"
        yield from (confusion(own), "", by(own, "damage"), "", by(own, "world"), "")
        yield from (good(own), "", kinds(own), "", untied(own), "", closures(own))
        seconds = sorted(row["seconds"] for row in known(own)) or [0.0]
        yield f"\nseconds a diagnosis: median {seconds[len(seconds) // 2]}, longest {seconds[-1]}"


def known(rows: Rows) -> list[dict[str, Any]]:
    """Rows of trials that came to an end."""
    return [row for row in rows if "failed" not in row]


def _said(rows: Rows, verdict: str) -> int:
    return sum(row["verdict"] == verdict for row in known(rows))


def _shares(rows: Rows) -> list[str]:
    right, decided = sum(row["verdict"] == row["expected"] for row in rows), len(rows) - _said(rows, "undecided")
    return [_share(right, decided), _share(right, len(rows))]


def _share(part: int, whole: int) -> str:
    return f"{100 * part / whole:.0f} %" if whole else "–"


def _line(cells: Sequence[Any]) -> str:
    return f"| {' | '.join(map(str, cells))} |"


def _rule(n: int) -> str:
    return "|" + "---|" * n
