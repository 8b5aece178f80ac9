"""`python -m scenarios NAME`: run an experiment; `python -m scenarios list` says what each shows."""

from __future__ import annotations

import json as json_text
import sys
from pathlib import Path
from typing import Annotated

import typer

from pgti_gtsam import outputs
from pgti_gtsam.errors import InvalidOptionError, PgtiError
from scenarios import kitti, load, near_misses, paper, pipeline, sweep, worlds
from scenarios import scans as scan_graphs
from scenarios import speed as speed_experiment
from scenarios import spikes as spikes_experiment
from scenarios import stream as stream_experiment
from scenarios.aliasing import figure, maps, tables, trials
from scenarios.aliasing.methods import METHODS
from scenarios.diagnosis import contacts_fit
from scenarios.diagnosis import maps as diagnosed_maps
from scenarios.diagnosis import narrow as narrow_cameras
from scenarios.diagnosis import tables as diagnosis_tables
from scenarios.diagnosis import trials as diagnosis_trials
from scenarios.evidence import calibration as reliability
from scenarios.evidence import radius_loss, rise_fit
from scenarios.fleet import commands as fleet_commands
from scenarios.mend import figure as mended_figure
from scenarios.mend import run as mending
from scenarios.mend import tables as mended_tables
from scenarios.paper import revisits
from scenarios.worlds.layouts import LAYOUTS

RESULTS = Path(__file__).parent / "results"
QUICK = [name for name in METHODS if name != trials.SLOW]

app = typer.Typer(add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False, rich_markup_mode=None)


fleet_commands.add_to(app)


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
    in_time_order: Annotated[
        bool, typer.Option("--in-time-order", help="One by one, and a review at the end.")
    ] = False,
) -> None:
    """Gate the loops that a real detector reported on KITTI; exit code 1 beyond 2 % wrong. Half a minute."""
    found = kitti.run(data, _names(sequences), _names(alpha), tell=print, in_time_order=in_time_order)
    for line in kitti.lines(found):
        print(line)
    text = json_text.dumps(found)
    if json is not None:
        outputs.write_text(json, text + "\n")
    print(text)
    if not all(row["passes"] for row in found.values()):
        raise typer.Exit(1)


@app.command()
def scans(
    data: Annotated[Path, typer.Option(help="Folder of the scan graphs, or of all data.")],
    seeds: Annotated[str, typer.Option(help="Seeds of the false closures, between commas.")] = "0,1,2,3,4",
    out: Annotated[Path, typer.Option(help="Where the JSON goes.")] = RESULTS / "scans.json",
) -> None:
    """Scan graphs with false closures between scans that look alike, through the gate. Two minutes."""
    found = scan_graphs.run(data, _whole_numbers(seeds), tell=print)
    out.parent.mkdir(parents=True, exist_ok=True)
    outputs.write_text(out, json_text.dumps(found, indent=1) + "\n")
    print(f"results: {out}")


@app.command("worlds")
def look_alike_worlds(
    names: Annotated[str, typer.Option("--worlds", help="Which, between commas.")] = ",".join(LAYOUTS),
    seeds: Annotated[str, typer.Option(help="Seeds of the drives, between commas.")] = "0,1,2,3,4",
    scheduler: Annotated[str | None, typer.Option(help="Address of a Dask scheduler; a local cluster without.")] = None,
    limit: Annotated[float, typer.Option(help="Processor seconds after which a method has failed.")] = 300.0,
    out: Annotated[Path, typer.Option(help="A JSON line a trial; known ones are kept.")] = RESULTS / "worlds.jsonl",
) -> None:
    """Seven ray-cast worlds that look alike: the gate and twelve others, told right and wrong sigmas. An hour."""
    wanted = _names(names)
    unknown = sorted(set(wanted) - set(LAYOUTS))
    if unknown:
        raise InvalidOptionError(f"expected worlds from {', '.join(LAYOUTS)}, got {', '.join(unknown)}")
    numbers = _whole_numbers(seeds)
    rows = sweep.run(out, list(trials.world_trials(wanted, numbers)), trials.row, scheduler, print, limit_s=limit)
    figure.draw(rows, out.with_suffix(".png"))
    maps.draw([worlds.problem(name, numbers[0]) for name in wanted], out.with_name(out.stem + "_maps.png"))
    even = [row for row in rows if row["share"] == 1.0]
    print("\nF1 by what methods are told\n" + tables.table(even, "setting"))
    print("\nF1 without the false closures that bring nothing into contact\n")
    print(tables.table(even, "setting", "f1_with_overlap"))
    right = [row for row in rows if row["setting"] == "right"]
    print("\nF1 by share of false closures, right sigmas\n" + tables.table(right, "share"))
    print("\nShare of keyframes whose place has a look-alike\n" + tables.ambiguities(rows))
    right = [row for row in right if row["share"] == 1.0]
    print("\nF1 by world, right sigmas\n" + tables.table(right, "world") + "\n\n" + tables.summary(right))
    print(f"results: {out}")


@app.command("drifts")
def odometry_that_errs_otherwise(
    seeds: Annotated[str, typer.Option(help="Seeds of the drives, between commas.")] = "0,1",
    scheduler: Annotated[str | None, typer.Option(help="Address of a Dask scheduler; a local cluster without.")] = None,
    limit: Annotated[float, typer.Option(help="Processor seconds after which a method has failed.")] = 300.0,
    out: Annotated[Path, typer.Option(help="A JSON line a trial; known ones are kept.")] = RESULTS / "drifts.jsonl",
) -> None:
    """The same worlds with other odometry: no drift to thrice the drift, slips, bad steps. A quarter of an hour."""
    wanted = list(trials.drift_trials(list(LAYOUTS), _whole_numbers(seeds)))
    rows = sweep.run(out, wanted, trials.row, scheduler, print, limit_s=limit)
    print("\nF1 by how the odometry errs\n" + tables.table(rows, "setting"))
    print("\nThe gate, by world\n")
    for kind in dict.fromkeys(row["setting"] for row in rows):
        own = [row for row in rows if row["setting"] == kind and row["method"] == "gate"]
        print(f"{kind}\n" + tables.table(own, "world"))
    print(f"results: {out}")


@app.command("field")
def outliers_in_standard_graphs(
    data: Annotated[Path, typer.Option(help="Folder of the standard graphs, or of all data.")],
    graphs: Annotated[str, typer.Option(help="Names, between commas; 3D ones too.")] = "CSAIL,MIT",
    seeds: Annotated[str, typer.Option(help="Seeds of the outliers, between commas.")] = "0,1,2,3,4",
    names: Annotated[str, typer.Option("--methods", help="Which, between commas.")] = ",".join(QUICK),
    scheduler: Annotated[str | None, typer.Option(help="Address of a Dask scheduler; a local cluster without.")] = None,
    limit: Annotated[float, typer.Option(help="Processor seconds after which a method has failed.")] = 300.0,
    out: Annotated[Path, typer.Option(help="A JSON line a trial; known ones are kept.")] = RESULTS / "field.jsonl",
) -> None:
    """Outliers of four kinds, 10 to 100 % of the inliers, in standard graphs, by every method. 20 minutes."""
    paths = [_standard_graphs(data) / f"{name}.g2o" for name in _names(graphs)]
    unknown = sorted(set(_names(names)) - set(METHODS))
    if unknown:
        raise InvalidOptionError(f"expected methods from {', '.join(METHODS)}, got {', '.join(unknown)}")
    wanted = list(trials.field_trials(paths, _whole_numbers(seeds), _names(names)))
    rows = sweep.run(out, wanted, trials.row, scheduler, print, limit_s=limit)
    for name in _names(graphs):
        own = [row for row in rows if row["world"] == name]
        random = [row for row in own if row["setting"] == "random"]
        print(f"\n{name}, F1 by share of random outliers\n" + tables.table(random, "share"))
        even = [row for row in own if row["share"] == 1.0]
        print(f"\n{name}, F1 by kind at 100 %\n" + tables.table(even, "setting"))
        print("\n" + tables.summary([row for row in even if row["setting"] == "random"]))
    print(f"results: {out}")


@app.command("diagnosis")
def known_damage(
    data: Annotated[Path | None, typer.Option(help="Folder with the real graphs; worlds only without.")] = None,
    names: Annotated[str, typer.Option("--worlds", help="Which, between commas.")] = ",".join(LAYOUTS),
    seeds: Annotated[str, typer.Option(help="Seeds of the drives, between commas.")] = ",".join(
        map(str, range(110, 118))
    ),
    undamaged: Annotated[str, typer.Option(help="Seeds of maps without damage.")] = ",".join(map(str, range(110, 125))),
    covisible: Annotated[str, typer.Option(help="Seeds of maps with landmarks.")] = "110",
    narrow: Annotated[str, typer.Option(help="Seeds of maps by a wide and a narrow camera.")] = "110,111,112",
    scheduler: Annotated[str | None, typer.Option(help="Address of a Dask scheduler; a local cluster without.")] = None,
    out: Annotated[Path, typer.Option(help="A JSON line a case; known ones are kept.")] = RESULTS / "diagnosis.jsonl",
) -> None:
    """Maps with known damage, diagnosed: verdicts against the truth, kinds of places, false closures. Half an hour."""
    wanted = _names(names)
    unknown = sorted(set(wanted) - set(LAYOUTS))
    if unknown:
        raise InvalidOptionError(f"expected worlds from {', '.join(LAYOUTS)}, got {', '.join(unknown)}")
    drawn = (_whole_numbers(text) for text in (seeds, undamaged, covisible))
    cases = list(diagnosis_trials.world_trials(wanted, *drawn))
    cameras = list(diagnosis_trials.narrow_trials(_whole_numbers(narrow)))
    cases += [trial for trial in cameras if trial not in cases]
    cases += diagnosis_trials.real_trials() if data is not None else []
    rows = sweep.run(out, cases, diagnosis_trials.row, scheduler, print, data=data)
    for line in diagnosis_tables.report(rows):
        print(line)
    seen = [row for trial, row in zip(cases, rows, strict=True) if trial in cameras]
    print("\nthe same maps by a wide and by a narrow camera\n\n" + "\n".join(narrow_cameras.paired(seen)))
    described = out.with_name(out.stem + "_maps.json")
    diagnosed_maps.write(rows, data, described)
    diagnosed_maps.draw(json_text.loads(described.read_text(encoding="utf-8")), out.with_suffix(".png"))
    print(f"results: {out}")


@app.command("contacts")
def which_contacts_are_real(
    seeds: Annotated[str, typer.Option(help="Seeds of the drives, between commas.")] = ",".join(
        map(str, range(1000, 1016))
    ),
    scheduler: Annotated[str | None, typer.Option(help="Address of a Dask scheduler; a local cluster without.")] = None,
    out: Annotated[Path, typer.Option(help="A JSON line a drive; known ones are kept.")] = RESULTS / "contacts.jsonl",
) -> None:
    """Contacts of odometry alone, in worlds with two kinds of drift: the fit that tells real ones. Five minutes."""
    wanted = list(contacts_fit.trials(list(LAYOUTS), _whole_numbers(seeds)))
    for line in contacts_fit.report(sweep.run(out, wanted, contacts_fit.row, scheduler, print)):
        print(line)
    print(f"results: {out}")


@app.command("rise")
def what_a_rise_says(
    seeds: Annotated[str, typer.Option(help="Seeds of the drives, between commas.")] = ",".join(
        map(str, range(1000, 1008))
    ),
    scheduler: Annotated[str | None, typer.Option(help="Address of a Dask scheduler; a local cluster without.")] = None,
    out: Annotated[Path, typer.Option(help="A JSON line a drive; known ones are kept.")] = RESULTS / "rise.jsonl",
) -> None:
    """Revisits that the drift leaves in doubt: the fit that says what a rise of the score is worth. Five minutes."""
    wanted = [rise_fit.Trial(name, seed) for seed in _whole_numbers(seeds) for name in LAYOUTS]
    for line in rise_fit.report(sweep.run(out, wanted, rise_fit.row, scheduler, print)):
        print(line)
    print(f"results: {out}")


@app.command("radius-loss")
def what_a_lost_radius_says(
    seeds: Annotated[str, typer.Option(help="Seeds of the drives, between commas.")] = "1000,1001",
    scheduler: Annotated[str | None, typer.Option(help="Address of a Dask scheduler; a local cluster without.")] = None,
    out: Annotated[Path, typer.Option(help="A JSON line a drive; known ones are kept.")] = RESULTS
    / "radius_loss.jsonl",
) -> None:
    """Revisits in doubt: what landmarks inside spheres that were free say beyond drift and rise. Five minutes."""
    wanted = [radius_loss.Trial(name, seed) for seed in _whole_numbers(seeds) for name in LAYOUTS]
    for line in radius_loss.report(sweep.run(out, wanted, radius_loss.row, scheduler, print)):
        print(line)
    print(f"results: {out}")


@app.command()
def calibration(
    data: Annotated[Path | None, typer.Option(help="Folder of all data; worlds only without.")] = None,
    graphs: Annotated[str, typer.Option(help="Names of real graphs, between commas.")] = "CSAIL,MIT,intel",
    seeds: Annotated[str, typer.Option(help="Held-out seeds, between commas.")] = "2010,2011",
    training: Annotated[str, typer.Option(help="Seeds of the temperature, between commas.")] = "1000,1001",
    scheduler: Annotated[str | None, typer.Option(help="Address of a Dask scheduler; a local cluster without.")] = None,
    out: Annotated[Path, typer.Option(help="A JSON line a trial; known ones are kept.")] = (
        RESULTS / "calibration.jsonl"
    ),
) -> None:
    """Are closures as often true as their probability says? Held-out drives, real graphs; a diagram. Ten minutes."""
    paths = [] if data is None else [_standard_graphs(data) / f"{name}.g2o" for name in _names(graphs)]
    paths += [] if data is None else [data / "bicocca" / near_misses.GRAPH]
    held_out = list(reliability.trials(list(LAYOUTS), _whole_numbers(seeds), paths))
    others = list(reliability.trials(list(LAYOUTS), _whole_numbers(training)))
    rows = sweep.run(out, held_out + others, reliability.row, scheduler, print)
    reliability.draw(rows[: len(held_out)], out.with_suffix(".png"))
    for line in reliability.report(rows[: len(held_out)], rows[len(held_out) :]):
        print(line)
    print(f"results: {out}")


@app.command("near-misses")
def real_near_misses(
    data: Annotated[Path, typer.Option(help="Folder of the Bicocca graphs, or of all data.")],
    out: Annotated[Path, typer.Option(help="Where the JSON goes.")] = RESULTS / "near_misses.json",
) -> None:
    """Bicocca's loops through the gate, false ones by what they miss by, at three radii. Half a minute."""
    rows = near_misses.run(data, tell=print)
    out.parent.mkdir(parents=True, exist_ok=True)
    outputs.write_text(out, json_text.dumps(rows, indent=1) + "\n")
    print("\n" + "\n".join(near_misses.report(rows)) + f"\nresults: {out}")


def _standard_graphs(data: Path) -> Path:
    return data / "pose_graphs" if (data / "pose_graphs").is_dir() else data


@app.command("pipeline")
def running_pipeline(
    largest: Annotated[int, typer.Option(help="Keyframes that are driven.")] = pipeline.SIZES[-1],
    out: Annotated[Path, typer.Option(help="Where the JSON and the figure go.")] = RESULTS / "pipeline.json",
) -> None:
    """What the gate costs in front of iSAM2, update by update, beside iSAM2 alone. Five minutes."""
    rows = pipeline.run(largest, seed=0, tell=print)
    out.parent.mkdir(parents=True, exist_ok=True)
    outputs.write_text(out, json_text.dumps(rows, indent=1) + "\n")
    pipeline.draw(rows, out.with_suffix(".png"))
    print(f"results: {out}")


@app.command("stream")
def stream_latency(
    largest: Annotated[int, typer.Option(help="Keyframes that are driven.")] = pipeline.SIZES[-1],
    state: Annotated[Path | None, typer.Option(help="Let the stream keep its map in this new file.")] = None,
    out: Annotated[Path, typer.Option(help="Where the JSON goes.")] = RESULTS / "stream.json",
) -> None:
    """How long a pipeline waits for a verdict of `gate --stream`. Two minutes."""
    rows = stream_experiment.run(largest, seed=0, state=state, tell=print)
    outputs.write_text(out, json_text.dumps(rows, indent=1) + "\n")
    print(f"results: {out}")


@app.command("load")
def closures_without_end(
    closures: Annotated[int, typer.Option(help="Closures that are offered, five at each keyframe.")] = 50_000,
    out: Annotated[Path, typer.Option(help="Where the JSON and the figure go.")] = RESULTS / "load.json",
) -> None:
    """Time, memory and open files of a gate that is offered closure upon closure. Hours; a thousand: a minute."""
    load.draw(load.run(closures, seed=0, path=out, tell=print), out.with_suffix(".png"))
    print(f"results: {out}")


@app.command("spikes")
def which_score_spikes(
    data: Annotated[Path | None, typer.Option(help="Folder of all data; worlds only without.")] = None,
    seeds: Annotated[str, typer.Option(help="Seeds of the drives, between commas.")] = "0,1,2,3,4",
    training: Annotated[str, typer.Option(help="Seeds that the limits are chosen on.")] = "1000,1001",
    scheduler: Annotated[str | None, typer.Option(help="Address of a Dask scheduler; a local cluster without.")] = None,
    out: Annotated[Path, typer.Option(help="A JSON line a map; known ones are kept.")] = RESULTS / "spikes.jsonl",
) -> None:
    """How seven scores of PGTI rise at true and at false closures, worlds and real maps. Half an hour."""
    wanted = spikes_experiment.trials(list(LAYOUTS), _whole_numbers(training) + _whole_numbers(seeds), data)
    for line in spikes_experiment.report(sweep.run(out, wanted, spikes_experiment.row, scheduler, print, data=data)):
        print(line)
    print(f"results: {out}")


@app.command("paper")
def paper_from_scratch(
    data: Annotated[
        Path | None, typer.Option(help="Folder of all data; row (a) on the true way of KITTI 00 too.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder of the figures and the JSON.")] = RESULTS / "paper",
) -> None:
    """The paper's curves, Table 4 and Figure 6 from scratch, and its limits: growth, texture. Ten minutes."""
    for line in paper.report(paper.run(data, out, tell=print)):
        print(line)
    print(f"results: {out}")


@app.command("best-revisits")
def best_new_ties(
    n_maps: Annotated[int, typer.Option("--maps", help="Drawn maps.")] = 50,
    n_keyframes: Annotated[int, typer.Option("--keyframes", help="Keyframes of each.")] = 300,
    out: Annotated[Path, typer.Option(help="A JSON line a map; known ones are kept.")] = RESULTS
    / "paper"
    / "revisits.jsonl",
) -> None:
    """Which new tie would lower Λ most, by low-rank updates and by trying all. Ten minutes."""
    print(revisits.summary(revisits.run(n_maps, n_keyframes, out, tell=print)))
    print(f"results: {out}")


@app.command("mend")
def mended_maps(
    data: Annotated[Path | None, typer.Option(help="Folder of all data; ray-cast worlds only without.")] = None,
    seeds: Annotated[str, typer.Option(help="Seeds of thinned loops and of drives, between commas.")] = "0",
    out: Annotated[Path, typer.Option(help="Where the JSON goes; known rows are kept.")] = RESULTS / "mend.json",
) -> None:
    """Scan graphs, a raw log and worlds with clouds on disk, mended; false ties, errors, sharpness. Half an hour."""
    for line in mended_tables.lines(mending.run(data, _whole_numbers(seeds), out, print)):
        print(line)
    if data is not None:
        mended_figure.draw(data / "radish_aces" / "aces.clf.bz2", out.with_suffix(".png"))
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
    except (PgtiError, OSError) as error:
        print(f"scenarios: {error}", file=sys.stderr)
        sys.exit(2)
