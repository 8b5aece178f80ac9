"""The terminal text: the summary of an audit document, verdicts on closures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

MAX_PLACES, MAX_CLOSURES = 8, 20
TERMS = (
    "Log odds of true against false, by what the other ties predict and, where that leaves doubt, by the free space "
    "that comes into contact."
)
_VERDICT_COLOURS = {"accepted": "green", "undecided": "yellow", "rejected": "red"}
_COLOURS = {"consistent": "green", "incomplete": "cyan", "undecided": "yellow", "inconsistent": "red"}
_KIND_COLOURS = {
    "likely false closure": "red",
    "undecided contact": "yellow",
    "missed closure": "cyan",
    "untied second pass": "cyan",
    "tracking gap": "cyan",
    "different view": "dim",
    "incomplete fusion": "dim",
}


def print_summary(document: Mapping[str, Any], console: Console) -> None:
    """Print the verdict, the places with their remedies, then the input and the scores.

    Text from a file is printed literally, never as markup.

    Parameters
    ----------
    document : mapping
        As `audit_document` makes it.
    console : Console
    """
    console.print(
        Group(
            _heading(document),
            *([_section("Where, and what to do", _places(document))] if document["places"] else []),
            *([_section("Closures, least probable first", _own_closures(document))] if document["closures"] else []),
            _section("Scores", _scores(document)),
            _section("Read", _read(document)),
        )
    )


def _heading(document: Mapping[str, Any]) -> RenderableType:
    judged, estimate = document["verdict"], document["estimate"]
    title = Text.assemble(
        (document["input"]["name"], "bold"), ": ", (judged["level"], f"bold {_COLOURS[judged['level']]}")
    )
    answer = Group(title, Text(judged["text"]))
    if estimate is None or estimate["is_optimum"]:
        return answer
    label = document["keyframes"]["label"][estimate["keyframe"]]
    stale = (
        f"The estimate is no optimum of its graph (error {estimate['error']:.4g}): one step moves keyframe {label} by "
        f"{estimate['step_m']:.3g} m. All of this is of the map as stored; --optimise audits the optimum."
    )
    return Group(answer, Text(stale, style="yellow"))


def _section(title: str, body: RenderableType) -> RenderableType:
    return Group(Text(""), Text(title, style="bold"), Padding(body, (0, 0, 0, 2)))


def _pairs() -> Table:
    table = Table.grid(padding=(0, 2))
    table.add_column(style="dim", no_wrap=True)
    table.add_column()
    return table


def _read(document: Mapping[str, Any]) -> RenderableType:
    table, summary, adaptation = _pairs(), document["summary"], document["adaptation"]
    table.add_row("format", Text(document["input"]["format"]))
    table.add_row("keyframes", f"{summary['n_keyframes']}")

    # what became of the factors
    if adaptation is not None:
        if adaptation["n_observations"]:
            table.add_row("landmarks", f"{adaptation['n_landmarks']} in {adaptation['n_observations']} sightings")
        sources = ", ".join(f"{count} {name}" for name, count in adaptation["edges"].items())
        table.add_row("edges", f"{summary['n_pose_graph_edges']} ({sources}, merged)")
        for what in ("used", "ignored"):
            table.add_row(f"factors {what}", Text(_counts(adaptation[what])))
        if adaptation["unknown"]:
            table.add_row(Text("factors unknown", style="yellow"), Text(_counts(adaptation["unknown"]), style="yellow"))
        if adaptation["empty_slots"]:
            table.add_row("empty slots", f"{adaptation['empty_slots']}")
        for line in _warnings(document):
            table.add_row(Text("note", style="yellow"), Text(line))
    else:
        table.add_row("edges", f"{summary['n_pose_graph_edges']}")

    # what the reader says
    for note in document["input"]["notes"]:
        table.add_row("note", Text(note))
    return table


def _counts(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {name}" for name, count in counts.items()) or "none"


def _warnings(document: Mapping[str, Any]) -> list[str]:
    adaptation, summary = document["adaptation"], document["summary"]
    lines = []
    if adaptation["keyframes_without_radius"]:
        lines.append(
            f"{adaptation['keyframes_without_radius']} keyframes without radius: nothing is guaranteed free around them"
        )
    if adaptation["landmarks_without_position"]:
        lines.append(f"{adaptation['landmarks_without_position']} landmarks could not be placed and give no radius")

    # what connects
    if 0 < adaptation["max_shared_landmarks"] < adaptation["min_shared_landmarks"]:
        lines.append(
            f"no two keyframes share {adaptation['min_shared_landmarks']} landmarks, so covisibility connects none; "
            f"the most that two share is {adaptation['max_shared_landmarks']} (--min-shared-landmarks)"
        )
    if document["estimate"] is None:
        lines.append("whether the estimate is an optimum could not be tried: the factor graph is singular there")
    if summary["n_components_pose_graph"] > 1:
        lines.append(
            f"the pose graph falls into {summary['n_components_pose_graph']} parts, "
            f"which free space joins into {summary['n_components_merged_graph']}"
        )
    return lines


def _scores(document: Mapping[str, Any]) -> RenderableType:
    summary, table = document["summary"], Table.grid(padding=(0, 2))
    split = summary["split"]
    worst = document["keyframes"]["label"][summary["worst"]]
    fused, collided = summary["n_fusion_edges"], summary["n_collision_edges"]
    rows = [
        ("Λ", summary["score"], f"largest change in how errors spread, at keyframe {worst}"),
        ("Λ_loc", split["local"], f"there, over the first {split['beta']:.0%} of the time scales: its neighbourhood"),
        ("Λ_glob", split["global"], "there, over the rest: the whole map"),
        ("Λ of fusion", summary["fusion"]["score"], f"overlaps that follow from ties, which are harmless: {fused}"),
        ("Λ of collisions", summary["collisions"]["score"], f"overlaps that nothing explains: {collided}"),
        ("Z̄", summary["mean_score"], "mean over the keyframes"),
        ("stable score", summary["stable_score"], "largest local change; does not shrink as the map grows"),
    ]
    for name, value, meaning in rows:
        table.add_row(Text(name, style="dim"), Text(_number(value), justify="right"), Text(meaning))
    return table


def _number(value: float | int | str) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _places(document: Mapping[str, Any]) -> RenderableType:
    table = Table(box=None, pad_edge=False, header_style="dim", padding=(0, 2, 0, 0))
    table.add_column("#", justify="right")
    table.add_column("kind", no_wrap=True)
    table.add_column("why, and what to do")
    places = document["places"]
    for place in places[:MAX_PLACES]:
        said = Text.assemble(place["sentence"], "\n", (place["remedy"], "bold"))
        table.add_row(str(place["rank"]), Text(place["kind"], style=_KIND_COLOURS[place["kind"]]), said)
    hidden = len(places) - MAX_PLACES
    more = [f"and {hidden} more, in the JSON and on the page (--json, --html)"] if hidden > 0 else []
    if any("(drift " in place["sentence"] for place in places[:MAX_PLACES]):
        more.append("drift: how far the two may lie apart, given all ties; spheres: what their radii reach together")
    return Group(table, *(Text(line, style="dim") for line in more))


def print_sweep(document: Mapping[str, Any], console: Console) -> None:
    """Print the verdicts with smaller and larger spheres.

    Parameters
    ----------
    document : mapping
        As `audit_document` makes it, with a sweep of the radii.
    console : Console
    """
    swept, table = document["radius_sweep"], Table(box=None, pad_edge=False, header_style="dim", padding=(0, 2, 0, 0))
    for name in ("radii times", "median (m)", "Λ"):
        table.add_column(name, justify="right")
    table.add_column("verdict")
    table.add_column("places")
    for row in swept["rows"]:
        places = ", ".join(f"{count} {kind}" for kind, count in row["places"].items()) or "none"
        verdict = Text(row["verdict"], style=_COLOURS[row["verdict"]])
        table.add_row(f"{row['factor']:g}", _number(row["median_radius_m"]), _number(row["score"]), verdict, places)
    held = "The verdict changes between half and twice the radii: it is fragile, measure the radii."
    held = held if swept["fragile"] else "The verdict holds from half to twice the radii."
    console.print(_section("Does the verdict hang on the radius?", Group(table, Text(held))))


def _own_closures(document: Mapping[str, Any]) -> RenderableType:
    table, labels, closures = Table.grid(padding=(0, 2)), document["keyframes"]["label"], document["closures"]
    false = [closure for closure in closures if closure["is_false"]]
    shown = closures[: max(min(len(false), MAX_CLOSURES), 1)]
    for closure in shown:
        i, j = closure["keyframes"]
        style = "red" if closure["is_false"] else "green"
        table.add_row(Text(f"{labels[i]} – {labels[j]}", style=style), _percent(closure), Text(closure["sentence"]))
    rest = len(closures) - len(shown)
    return Group(table, *([Text(f"and {rest} more that are more probable", style="dim")] if rest else []))


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
            (f"{record['verdict']:9}", _VERDICT_COLOURS[record["verdict"]]),
            f"  {pair:{width}}  {_percent(record):>5}  ",
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
    table = Table(box=None, pad_edge=False, header_style="dim")
    is_known = any(record["is_true"] is not None for record in records)
    table.add_column("verdict")
    for name in ("keyframes", "probability", "log odds", "of drift", "of contacts"):
        table.add_column(name, justify="right", no_wrap=True)
    if is_known:
        table.add_column("known")
    for record in records[:MAX_CLOSURES]:
        terms = record["terms"]
        table.add_row(
            Text(record["verdict"], style=_VERDICT_COLOURS[record["verdict"]]),
            Text(_pair(record)),
            _percent(record),
            _share(record["log_odds"]),
            *(_share(terms[name]["log_odds"]) if name in terms else "–" for name in ("drift", "contact_rise")),
            _known(record),
        )
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
    count = {verdict: sum(record["verdict"] == verdict for record in records) for verdict in _VERDICT_COLOURS}
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


def _share(value: float | str) -> str:
    return f"{value:.2f}" if isinstance(value, float) else str(value)


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


def _percent(record: Mapping[str, Any]) -> str:
    """A probability that does not round to certainty."""
    probability = record["probability"]
    if not isinstance(probability, float):
        return "?"
    return "<1 %" if probability < 0.01 else ">99 %" if probability > 0.99 else f"{100 * probability:.0f} %"


def print_heat(document: Mapping[str, Any], console: Console) -> None:
    """Print the findings, each with its meaning.

    Parameters
    ----------
    document : mapping
        As `heat_document` makes it.
    console : Console
    """
    table = Table.grid(padding=(0, 2))
    table.add_column(style="dim", no_wrap=True)
    table.add_column()
    table.add_column(style="dim")
    for row in _heat_rows(document):
        table.add_row(*(Text(cell) for cell in row))
    console.print(Text(document["name"], style="bold"))
    console.print(table)


def _heat_rows(document: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    exponents = document["spreading_exponents"]
    others = document["n_other_variables"]
    rows = [
        ("keyframes", f"{document['n_keyframes']} {document['group']}", f"{document['n_edges']} pairs exchange heat"),
        ("parts", f"{document['parts']}", f"{len(document['grounds_added'])} held for this study, as no factor does"),
        *([("marginalised", f"{others}", "landmarks and other variables")] if others else []),
        ("defect, GTSAM's frame", _short(document["laplacian_defect_body"]), "0 for a block Laplacian"),
        ("defect, spatial frame", _short(document["laplacian_defect_spatial"]), "Eq. 12 holds where 0"),
        (
            "Eq. 11, A = −B",
            _short(document["equation_11_antisymmetry"]),
            f"worst of {document['equation_11_factors']} between factors",
        ),
        ("steady state, Gauss-Newton", _short(document["steady_state_error"]), "distance relative to the step"),
        (
            "scalar Laplacian as a proxy",
            _short(document["proxy_rank_correlation"]),
            "rank correlation of heat left",
        ),
        (
            "arrival ~ hops to the power",
            ", ".join(f"{frame} {value:.1f}" for frame, value in exponents.items() if value is not None) or "–",
            "2 is heat, 4 is bending",
        ),
    ]
    for run in document["optimisers"]:
        rows.append((run["method"], *_first_step(run)))
    return rows


def _first_step(run: Mapping[str, Any]) -> tuple[str, str]:
    if not run["energies"]:
        return "none", "the optimiser found the graph singular"
    at = run["first_step_is_flow_at"]
    time = at if isinstance(at, str) else f"t = {_short(at)}"
    return time, f"where its first step is, missed by {_short(run['first_step_missed_by'])}"


def _short(value: float | None) -> str:
    return "–" if value is None else f"{value:.3g}"
