"""The terminal text of a mended map: before and after, closures taken out and put in, and places left."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Console, Group
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

MAX_LINES = 8
_LEVELS = {"consistent": "green", "incomplete": "cyan", "undecided": "yellow", "inconsistent": "red"}
_OUTCOMES = {"confirmed": "green", "undecided": "yellow", "refused": "red"}


def print_mended(document: Mapping[str, Any], console: Console) -> None:
    """Print what mending did. Text from a file is printed literally, never as markup.

    Parameters
    ----------
    document : mapping
        As `report.mended` makes it.
    console : Console
    """
    count = {outcome: len(_of(document, outcome)) for outcome in _OUTCOMES}
    out, tried = document["out"], len(document["attempts"])
    console.print(
        Text.assemble(
            (document["input"]["name"], "bold"),
            f": {_count(len(out), 'closure')} out, {_count(count['confirmed'], 'tie')} in, of {tried} tried",
        )
    )
    console.print(_sides(document))
    _print_section("Out: closures that do not pass the gate", [_out(document, each) for each in out], console)
    confirmed = [_attempt(each) for each in _of(document, "confirmed")]
    _print_section("In: ties that were confirmed", confirmed, console)
    for outcome, title in (("undecided", "Not tied, for nothing decides"), ("refused", "Not tied, for it is refused")):
        _print_section(title, [_attempt(each) for each in _of(document, outcome)], console)
    for note in document["input"]["notes"]:
        console.print(Text(f"note: {note}", style="dim"), soft_wrap=True)


def _sides(document: Mapping[str, Any]) -> Table:
    table = Table(box=None, pad_edge=False, header_style="dim", padding=(0, 3, 0, 0))
    for name in ("", "before", "after"):
        table.add_column(name)
    before, after = document["before"], document["after"]
    levels = [side["verdict"]["level"] for side in (before, after)]
    table.add_row("verdict", *(Text(level, style=_LEVELS[level]) for level in levels))
    for kind in sorted({*before["places"], *after["places"]} - {"incomplete fusion"}):
        table.add_row(kind, *(str(side["places"].get(kind, 0)) for side in (before, after)))
    table.add_row("closures", *(str(side["n_closures"]) for side in (before, after)))
    table.add_row("collisions", *(str(side["n_collisions"]) for side in (before, after)))
    table.add_row("Λ of collisions", *(_number(side["collision_score"]) for side in (before, after)))
    return table


def _print_section(title: str, lines: list[Text], console: Console) -> None:
    if not lines:
        return
    more = [Text(f"and {len(lines) - MAX_LINES} more, in the JSON and on the page (--json, --html)", style="dim")]
    body = Group(*lines[:MAX_LINES], *(more if len(lines) > MAX_LINES else []))
    console.print(Group(Text(""), Text(title, style="bold"), Padding(body, (0, 0, 0, 2))))


def _attempt(attempt: Mapping[str, Any]) -> Text:
    place = f"{attempt['place']}: " if attempt["place"] else ""
    said = attempt["reason"]
    if attempt["outcome"] == "confirmed" and attempt["agreement"] is not None:
        said = (
            f"moved {attempt['moved_m']:.2f} m and {attempt['moved_deg']:.1f}° from the prediction, "
            f"the views agree in {100 * attempt['agreement']:.0f} %"
        )
    first, second = attempt["labels"]
    return Text.assemble((f"{first} – {second}  ", _OUTCOMES[attempt["outcome"]]), f"{place}{said}")


def _out(document: Mapping[str, Any], closure: Mapping[str, Any]) -> Text:
    labels = [document["keyframes"]["label"][k] for k in closure["keyframes"]]
    return Text.assemble((" – ".join(labels), "red"), f"  {closure['verdict']}. {closure['reason']}")


def _of(document: Mapping[str, Any], outcome: str) -> list[Mapping[str, Any]]:
    return [attempt for attempt in document["attempts"] if attempt["outcome"] == outcome]


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _number(value: float | str) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
