"""The terminal summary of an audit document."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

MAX_PLACES = 8
_COLOURS = {"consistent": "green", "harmless": "green", "suspicious": "yellow", "broken": "red"}


def print_summary(document: Mapping[str, Any], console: Console) -> None:
    """Print what was read, the verdict, the scores and the worst places.

    Text that comes from a file is printed as it is: never read as markup.
    """
    console.print(
        Group(
            _heading(document),
            _section("Read", _read(document)),
            _section("Scores", _scores(document)),
            *([_section("Places, worst first", _places(document))] if document["places"] else []),
        )
    )


def _heading(document: Mapping[str, Any]) -> RenderableType:
    judged = document["summary"]["verdict"]
    title = Text.assemble(
        (document["input"]["name"], "bold"), ": ", (judged["level"], f"bold {_COLOURS[judged['level']]}")
    )
    return Group(title, Text(judged["text"]))


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
    if 0 < adaptation["max_shared_landmarks"] < adaptation["min_shared_landmarks"]:
        lines.append(
            f"no two keyframes share {adaptation['min_shared_landmarks']} landmarks, so covisibility connects none; "
            f"the most that two share is {adaptation['max_shared_landmarks']} (--min-shared-landmarks)"
        )
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
    rows = [
        ("Λ", summary["score"], f"largest change in how errors spread, at keyframe {worst}"),
        ("Λ_loc", split["local"], f"there, over the first {split['beta']:.0%} of the time scales: its neighbourhood"),
        ("Λ_glob", split["global"], "there, over the rest: the whole map"),
        ("Z̄", summary["mean_score"], "mean over the keyframes"),
        ("stable score", summary["stable_score"], "largest local change; does not shrink as the map grows"),
        ("missing edges", summary["n_inserted_edges"], "pairs that free space connects and the pose graph does not"),
    ]
    for name, value, meaning in rows:
        table.add_row(Text(name, style="dim"), Text(_number(value), justify="right"), Text(meaning))
    return table


def _number(value: float | int | str) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _places(document: Mapping[str, Any]) -> RenderableType:
    table = Table(box=None, pad_edge=False, header_style="dim")
    for name in ("#", "stable", "ζ", "missing", "keyframe"):
        table.add_column(name, justify="right")
    table.add_column("position (m)")
    table.add_column("keyframes in contact")
    labels, places = document["keyframes"]["label"], document["places"]
    for place in places[:MAX_PLACES]:
        table.add_row(
            str(place["rank"]),
            _number(place["stable_score"]),
            _number(place["score"]),
            str(place["n_inserted_edges"]),
            Text(place["label"]),
            ", ".join(f"{x:.1f}" for x in place["position"]),
            Text(_ranges(place["keyframes"], labels)),
        )
    hidden = len(places) - MAX_PLACES
    more = [Text(f"and {hidden} more, in the JSON and on the page (--json, --html)", style="dim")] if hidden > 0 else []
    return Group(table, *more)


def _ranges(indices: list[int], labels: list[str], most: int = 6) -> str:
    """Runs of consecutive keyframes as `x3–x9`."""
    runs: list[list[int]] = []
    for i in indices:
        if runs and i == runs[-1][-1] + 1:
            runs[-1].append(i)
        else:
            runs.append([i])
    words = [labels[run[0]] if len(run) == 1 else f"{labels[run[0]]}–{labels[run[-1]]}" for run in runs]
    return ", ".join(words[:most]) + (f" and {len(words) - most} more" if len(words) > most else "")
