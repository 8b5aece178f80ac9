"""Commands of the experiments with many maps and with a large map."""

from __future__ import annotations

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from pgti_gtsam import outputs
from scenarios.fleet import growth, links, night, speedup

RESULTS = Path(__file__).parents[1] / "results"


def add_to(app: typer.Typer) -> None:
    """Let an application know the commands."""
    for name, command in (
        ("fleet", many_maps),
        ("city", city_in_parts),
        ("links", links_between_maps),
        ("workers", two_workers),
    ):
        app.command(name)(command)


def many_maps(
    n_maps: Annotated[int, typer.Option("--maps", help="Files, of which one is cut off and one never ends.")] = 200,
    first_seed: Annotated[int, typer.Option(help="Of the drives; from 1000 on they are for training.")] = 0,
    folder: Annotated[Path, typer.Option(help="For the maps, their pages and the index page.")] = Path("fleet"),
    out: Annotated[Path, typer.Option(help="Where the JSON goes.")] = RESULTS / "fleet.json",
) -> None:
    """200 maps with known damage, audited by two workers of which one is killed; the ranking. Twenty minutes."""
    found = night.run(folder, n_maps, first_seed, tell=print)
    outputs.write_text(out, json.dumps(found, indent=1) + "\n")
    print("\n".join(night.report(found)) + f"\nresults: {out}")


def two_workers(
    n_maps: Annotated[int, typer.Option("--maps", help="Drives that are audited.")] = 16,
    n_pairs: Annotated[int, typer.Option("--pairs", help="Times that both are timed.")] = 3,
    out: Annotated[Path, typer.Option(help="Where the JSON goes.")] = RESULTS / "workers.json",
) -> None:
    """How much faster two workers audit than one, on a quiet machine of two cores. Five minutes."""
    with TemporaryDirectory() as folder:
        found = speedup.run(Path(folder), n_maps, n_pairs, tell=print)
    outputs.write_text(out, json.dumps(found, indent=1) + "\n")
    print(f"two workers are {found['speed_up']} times as fast as one\nresults: {out}")


def city_in_parts(
    largest: Annotated[int, typer.Option(help="Keyframes of the largest city.")] = growth.SIZES[-1],
    out: Annotated[Path, typer.Option(help="A JSON line a row; known ones are kept.")] = RESULTS / "city.jsonl",
) -> None:
    """One city whole and in parts: the same verdict, time and memory, up to a million keyframes. An hour."""
    rows = growth.run(out, [n for n in growth.SIZES if n <= largest], tell=print)
    print("\n".join(growth.report(rows)) + f"\nresults: {out}")


def links_between_maps(
    teams: Annotated[int, typer.Option(help="Teams of three robots.")] = 10,
    out: Annotated[Path, typer.Option(help="A JSON line a team; known ones are kept.")] = RESULTS / "links.jsonl",
) -> None:
    """True and wrong links between the maps of three robots: which of them fuse maps. Three minutes."""
    print("\n".join(links.report(links.run(out, range(teams), tell=print))) + f"\nresults: {out}")
