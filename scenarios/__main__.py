"""`python -m scenarios NAME`: run one experiment; `python -m scenarios list` says what each shows."""

from __future__ import annotations

import json as json_text
import sys
from pathlib import Path
from typing import Annotated

import typer

from pgti_gtsam.errors import InvalidOptionError, PgtiError
from scenarios import aliasing, kitti
from scenarios import scans as scan_graphs
from scenarios import speed as speed_experiment
from scenarios.aliasing import figure

RESULTS = Path(__file__).parent / "results"

app = typer.Typer(add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False, rich_markup_mode=None)


@app.command("list")
def list_experiments() -> None:
    """Say what each experiment shows and how long it takes."""
    for command in app.registered_commands:
        if command.callback is not list_experiments and command.callback is not None:
            name = command.name or command.callback.__name__
            print(f"{name:12s} {(command.callback.__doc__ or '').strip()}")


@app.command()
def speed(
    data: Annotated[Path | None, typer.Option(help="Folder with the real graphs; synthetic ones only without.")] = None,
    largest: Annotated[int, typer.Option(help="Vertices of the largest synthetic graph.")] = 100_000,
    dense_up_to: Annotated[int, typer.Option(help="Vertices up to which dense decomposition is timed too.")] = 3000,
    out: Annotated[Path, typer.Option(help="Where the JSON goes.")] = RESULTS / "speed.json",
) -> None:
    """Heat kernel of all vertices: poles, dense, Lanczos; time, memory, error, growth. Over ten minutes."""
    found = speed_experiment.run(data, largest, dense_up_to, tell=print)
    speed_experiment.write(found, out)
    print(f"results: {out}")


@app.command("gate-kitti")
def gate_kitti(
    data: Annotated[Path, typer.Option(help="Folder of the RobustSLAM sequences, or of all data.")],
    sequences: Annotated[str, typer.Option(help="Which, between commas.")] = "00,06,07",
    alpha: Annotated[str, typer.Option(help="Detector thresholds, between commas; all there are without.")] = "",
    json: Annotated[Path | None, typer.Option(help="Write what is found to this file too.")] = None,
) -> None:
    """Gate the loops that a real detector reported on KITTI; exit code 1 beyond 2 % wrong. Half a minute."""
    found = kitti.run(data, _names(sequences), _names(alpha), tell=print)
    for line in kitti.lines(found):
        print(line)
    text = json_text.dumps(found)
    if json is not None:
        json.write_text(text + "\n", encoding="utf-8")
    print(text)
    if not all(row["passes"] for row in found.values()):
        raise typer.Exit(1)


@app.command()
def scans(
    data: Annotated[Path, typer.Option(help="Folder of the scan graphs, or of all data.")],
    seeds: Annotated[str, typer.Option(help="Seeds of the false closures, between commas.")] = "0,1,2,3,4",
    out: Annotated[Path, typer.Option(help="Where the JSON goes.")] = RESULTS / "scans.json",
) -> None:
    """Scan graphs with false closures between places at least 5 m apart, through the gate. Two minutes."""
    found = scan_graphs.run(data, _whole_numbers(seeds), tell=print)
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json_text.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(f"results: {out}")


@app.command()
def streets(
    seeds: Annotated[str, typer.Option(help="Seeds of the drives, between commas.")] = "0,1,2,3,4",
    scheduler: Annotated[str | None, typer.Option(help="Address of a Dask scheduler; a local cluster without.")] = None,
    out: Annotated[Path, typer.Option(help="A JSON line a trial; known ones are kept.")] = RESULTS / "streets.jsonl",
) -> None:
    """Look-alike crossings: the gate and ten other methods, told right and wrong covariances. Five minutes."""
    rows = aliasing.run(out, list(aliasing.street_trials(_whole_numbers(seeds))), scheduler, tell=print)
    figure.draw(rows, out.with_suffix(".png"))
    print(aliasing.table([row for row in rows if row["share"] == 1.0], "told"))
    print(f"results: {out}")


@app.command("field")
def outliers_in_standard_graphs(
    data: Annotated[Path, typer.Option(help="Folder of the standard graphs, or of all data.")],
    graphs: Annotated[str, typer.Option(help="Names of planar graphs, between commas.")] = "CSAIL,MIT",
    seeds: Annotated[str, typer.Option(help="Seeds of the outliers, between commas.")] = "0,1,2,3,4",
    scheduler: Annotated[str | None, typer.Option(help="Address of a Dask scheduler; a local cluster without.")] = None,
    out: Annotated[Path, typer.Option(help="A JSON line a trial; known ones are kept.")] = RESULTS / "field.jsonl",
) -> None:
    """Random outliers, 10 to 100 % of the inliers, in standard graphs, by every method. Twenty minutes."""
    folder = data / "pose_graphs" if (data / "pose_graphs").is_dir() else data
    paths = [folder / f"{name}.g2o" for name in _names(graphs)]
    rows = aliasing.run(out, list(aliasing.field_trials(paths, _whole_numbers(seeds))), scheduler, tell=print)
    for name in _names(graphs):
        print(f"\n{name}\n" + aliasing.table([row for row in rows if row["world"] == name], "share"))
    print(f"results: {out}")


def _whole_numbers(text: str) -> list[int]:
    try:
        return [int(name) for name in _names(text)]
    except ValueError as error:
        raise InvalidOptionError(f"expected whole numbers between commas, got {text!r}") from error


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


if __name__ == "__main__":
    try:
        app()
    except PgtiError as error:
        print(f"scenarios: {error}", file=sys.stderr)
        sys.exit(2)
