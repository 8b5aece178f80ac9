"""The terminal text of audits and of the heat view."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from pgti_gtsam.report.closure_text import MAX_CLOSURES, VERDICT_COLOURS, percent

MAX_PLACES = 8
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


def print_merging(merging: Mapping[str, Any], console: Console) -> None:
    """Print which links fused which maps.

    Parameters
    ----------
    merging : mapping
        As `merging_record` makes it.
    console : Console
    """
    # the links
    table, links = Table.grid(padding=(0, 2)), merging["links"]
    for link in links[:MAX_CLOSURES]:
        name = Text(" – ".join(link["keyframes"]), style=VERDICT_COLOURS[link["verdict"]])
        table.add_row(name, link["verdict"], percent(link), Text(link["sentence"]))
    if len(links) > MAX_CLOSURES:
        table.add_row(Text(f"and {len(links) - MAX_CLOSURES} more", style="dim"))

    # the maps
    maps = _pairs()
    for joining in merging["order"]:
        sure = f"{len(joining['links'])} links, probability {joining['probability']:.4f}"
        maps.add_row(Text(" + ".join(joining["maps"])), Text(sure))
    for gain in merging["gains"]:
        surer = f"{gain['n_links']} links; drift between its keyframes {gain['before_m']:.2g} m alone, "
        maps.add_row(Text(gain["map"]), Text(f"{surer}{gain['after_m']:.2g} m now"))
    if left_out := merging["left_out"]:
        shown = ", ".join(left_out[:MAX_CLOSURES]) + (", …" if len(left_out) > MAX_CLOSURES else "")
        maps.add_row("left out", Text(f"variables that no factor ties to a keyframe: {len(left_out)} ({shown})"))
    console.print(Group(_section("Links between maps", table), _section("Maps, joined in this order", maps), Text("")))


def print_parts(document: Mapping[str, Any], console: Console) -> None:
    """Print what an audit in parts found, and what it took.

    Parameters
    ----------
    document : mapping
        As `parts_document` makes it.
    console : Console
    """
    # numbers of the parts
    summary, parts = document["summary"], document["parts"]
    rows = {
        "keyframes": f"{summary['n_keyframes']} in {len(parts)} parts, the largest with "
        f"{max(part['n_keyframes'] for part in parts)}",
        "overlaps": f"{summary['n_fusion_edges']} that follow from ties, {summary['n_collision_edges']} that nothing "
        "explains",
        "memory": f"{max(part['peak_mb'] for part in parts):.0f} MB for a part, {summary['peak_mb']:.0f} MB where all "
        "comes together",
        **{step: f"{seconds:.3g} s" for step, seconds in summary["seconds"].items()},
    }
    table = _pairs()
    for name, value in rows.items():
        table.add_row(Text(name), Text(value))

    # the verdict, places, closures, and the numbers
    console.print(
        Group(
            _heading(document),
            *([_section("Where, and what to do", _places(document))] if document["places"] else []),
            *([_section("Closures, least probable first", _own_closures(document))] if document["closures"] else []),
            _section("Parts", table),
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
    told = "The verdict changes between half and twice the radii: it is fragile, measure the radii."
    told = told if swept["fragile"] else "The verdict holds from half to twice the radii."
    console.print(_section("Does the verdict depend on the radius?", Group(table, Text(told))))


def _own_closures(document: Mapping[str, Any]) -> RenderableType:
    table, labels, closures = Table.grid(padding=(0, 2)), document["keyframes"]["label"], document["closures"]
    false = [closure for closure in closures if closure["is_false"]]
    shown = closures[: max(min(len(false), MAX_CLOSURES), 1)]
    for closure in shown:
        i, j = closure["keyframes"]
        style = "red" if closure["is_false"] else "green"
        table.add_row(Text(f"{labels[i]} – {labels[j]}", style=style), percent(closure), Text(closure["sentence"]))
    rest = len(closures) - len(shown)
    return Group(table, *([Text(f"and {rest} more that are more probable", style="dim")] if rest else []))


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
    for row in document["findings"]:
        table.add_row(*(Text(cell) for cell in row))
    console.print(Text(document["input"]["name"], style="bold"))
    console.print(table)
