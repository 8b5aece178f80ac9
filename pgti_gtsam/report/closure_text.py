"""The terminal text of loop closures: verdicts, the least probable closures, a tally."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

MAX_CLOSURES = 20
TERMS = (
    "Log odds of true against false, by the prediction of the other ties and, where that leaves doubt, by the free "
    "space that comes into contact."
)
VERDICT_COLOURS = {"accepted": "green", "undecided": "yellow", "rejected": "red"}


def print_heading(name: str, what: str, notes: Sequence[str], console: Console) -> None:
    """Print the name of the map, and the meaning of the number behind each verdict.

    Parameters
    ----------
    name : str
        Name of the map.
    what : str
        Noun of the number behind each verdict.
    notes : sequence of str
        Notes on the input.
    console : Console
    """
    console.print(Text.assemble((name, "bold"), f": {what}"), soft_wrap=True)
    for note in notes:
        console.print(Text(f"note: {note}", style="dim"), soft_wrap=True)
    console.print(Text("in front of each reason: the probability that the closure is true", style="dim"))
    console.print()


def print_decisions(records: Sequence[Mapping[str, Any]], console: Console) -> None:
    """Print a line for each closure: verdict, keyframes, probability, truth if known, the gravest reason.

    Parameters
    ----------
    records : sequence of mapping
        As `decision_records` makes them.
    console : Console
    """
    pairs = [_pair(record) for record in records]
    width = max(map(len, pairs), default=0)
    is_scored = any(record["global_score"] is not None for record in records)
    for record, pair in zip(records, pairs, strict=True):
        known = () if record["is_true"] is None else ("known ", _known(record), ": ")
        said = Text.assemble(
            (f"{record['verdict']:9}", VERDICT_COLOURS[record["verdict"]]),
            f"  {pair:{width}}  {percent(record):>5}  ",
            f"Λ_glob {_change(record['global_score'])}  " if is_scored else "",
            *known,
            _reason(record),
        )
        console.print(said, soft_wrap=True)
    if records and not is_scored:
        console.print(Text("Λ_glob before and after was left out; --scores computes both, slowly", style="dim"))


def print_closures(records: Sequence[Mapping[str, Any]], console: Console) -> None:
    """Print the least probable closures, given in that order, as a table with the parts of the log odds.

    Parameters
    ----------
    records : sequence of mapping
        As `closures_document` orders them.
    console : Console
    """
    # columns
    table = Table(box=None, pad_edge=False, header_style="dim")
    is_known = any(record["is_true"] is not None for record in records)
    table.add_column("verdict")
    for name in ("keyframes", "probability", "log odds", "of drift", "of contacts"):
        table.add_column(name, justify="right", no_wrap=True)
    if is_known:
        table.add_column("known")

    # a row each
    for record in records[:MAX_CLOSURES]:
        terms = record["terms"]
        table.add_row(
            Text(record["verdict"], style=VERDICT_COLOURS[record["verdict"]]),
            Text(_pair(record)),
            percent(record),
            _share(record["log_odds"]),
            *(_share(terms[name]["log_odds"]) if name in terms else "–" for name in ("drift", "contact_rise")),
            _known(record),
        )

    # the table, and how many more there are
    if records:
        console.print(table)
        console.print(Text(TERMS, style="dim"))
    if len(records) > MAX_CLOSURES:
        console.print(Text(f"and {len(records) - MAX_CLOSURES} more, in the JSON (--json)", style="dim"))


def print_tally(records: Sequence[Mapping[str, Any]], console: Console, *, seconds: float) -> None:
    """Print how many closures passed, and how many of known truth rightly.

    Parameters
    ----------
    records : sequence of mapping
        As `decision_records` makes them.
    console : Console
    seconds : float
        Time of the run.
    """
    count = {verdict: sum(record["verdict"] == verdict for record in records) for verdict in VERDICT_COLOURS}
    console.print()
    told = ", ".join(f"{number} {verdict}" for verdict, number in count.items())
    console.print(Text(f"{len(records)} closures in {seconds:.1f} s: {told}"))
    for is_true, what, wanted in ((True, "true", "accepted"), (False, "false", "not accepted")):
        known = [record for record in records if record["is_true"] is is_true]
        if known:
            right = sum(record["accepted"] is is_true for record in known)
            style = "green" if right == len(known) else "yellow"
            console.print(Text(f"known to be {what}: {len(known)}, of which {right} {wanted}", style=style))


def print_left_out(counts: Mapping[str, int], where: str, console: Console) -> None:
    """Print the parts that a file lacks, by kind.

    Parameters
    ----------
    counts : mapping
        Numbers by kind.
    where : str
        Name of the file.
    console : Console
    """
    for what, count in counts.items():
        console.print(Text(f"left out of {where}: {count} {what}", style="yellow"), soft_wrap=True)


def _pair(record: Mapping[str, Any]) -> str:
    (_, earlier), (_, later) = sorted(zip(record["keys"], record["keyframes"], strict=True))
    return f"{earlier} – {later}"


def _change(score: Mapping[str, Any] | None) -> str:
    return f"{'–':^11}" if score is None else f"{_share(score['before'])} → {_share(score['after'])}"


def _share(value: float | str | None) -> str:
    return "–" if value is None else f"{value:.2f}" if isinstance(value, float) else value


def _known(record: Mapping[str, Any]) -> Text:
    """Whether a closure is known to be true or false, marked where the verdict is another."""
    if record["is_true"] is None:
        return Text()
    style = "" if record["is_true"] is record["accepted"] else "bold yellow"
    return Text("true" if record["is_true"] else "false", style=style)


def _reason(record: Mapping[str, Any]) -> str:
    """The heaviest reason, the number of others, and the number of closures weighed together."""
    first, more = str(record["reasons"][0]), record["reasons"][1:]
    others = record["judged_with"] - 1
    together = f" Weighed with {others} other{'s' if others > 1 else ''} of its revisit." if others else ""
    return first + together + (f" (+{len(more)} more)" if more else "")


def percent(record: Mapping[str, Any]) -> str:
    """The probability of a closure, not rounded to certainty."""
    probability = record["probability"]
    if not isinstance(probability, float):
        return "?"
    return "<1 %" if probability < 0.01 else ">99 %" if probability > 0.99 else f"{100 * probability:.0f} %"
