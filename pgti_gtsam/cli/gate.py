"""`pgti-gtsam gate` and `closures`: sift the loop closures of a graph, or judge the closures of a finished map."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from pgti_gtsam import outputs
from pgti_gtsam.adapter import MIN_SHARED_LANDMARKS
from pgti_gtsam.adapter.values import Keyframes, read_keyframes
from pgti_gtsam.cli.options import (
    Cloud,
    Edges,
    Every,
    IgnoreUnknown,
    Loops,
    Map,
    MapFiles,
    MinShared,
    OneMap,
    Radius,
    Values,
    print_paths,
    read_map,
    split_names,
    terminal,
)
from pgti_gtsam.cli.progress import counted
from pgti_gtsam.cli.stream import check_alone, serve_socket, serve_standard_input
from pgti_gtsam.datasets import Dataset
from pgti_gtsam.datasets.chain import between_factors
from pgti_gtsam.datasets.formats import gtsam_archive
from pgti_gtsam.datasets.writer import Outcome, write_graph
from pgti_gtsam.errors import InvalidOptionError
from pgti_gtsam.gate import GatedGraph, GateOptions, LoopClosureGate, gate_graph
from pgti_gtsam.gate.batch import leave_one_out
from pgti_gtsam.plain_text import visible
from pgti_gtsam.report.closure_text import (
    print_closures,
    print_decisions,
    print_heading,
    print_left_out,
    print_tally,
)
from pgti_gtsam.report.decisions import (
    Record,
    closures_document,
    decision_records,
    least_probable_first,
    write_json_lines,
)
from pgti_gtsam.report.document import write_json
from pgti_gtsam.report.gate_page import write_gate_page

ARCHIVES = (gtsam_archive.NAME, gtsam_archive.XML_NAME)
Tell = Callable[[str, int, int], None]
MapOrStream = Annotated[
    list[Path] | None,
    typer.Argument(
        help="Map with loop closures, of any kind that audit reads; none with --stream.", show_default=False
    ),
]


def gate(
    file: MapOrStream = None,
    values: Values = None,
    loops: Loops = None,
    one_map: OneMap = False,
    ignore_unknown: IgnoreUnknown = False,
    radius: Radius = None,
    cloud: Cloud = None,
    edges: Edges = None,
    min_shared_landmarks: MinShared = None,
    every: Every = 1,
    rule: Annotated[
        str, typer.Option(help="log_odds, or of the paper global_rise, keyframe_rise or keyframe_global_rise.")
    ] = "log_odds",
    min_probability: Annotated[float, typer.Option(help="Accept closures from this probability on.")] = 0.95,
    scores: Annotated[
        bool | None,
        typer.Option(help="Λ and Λ_glob before and after each closure. Default: where the map is not too large."),
    ] = None,
    decisions: Annotated[Path | None, typer.Option(help="Write every decision, a JSON object a line.")] = None,
    json: Annotated[Path | None, typer.Option(help="Write all decisions and the map to this JSON file.")] = None,
    html: Annotated[Path | None, typer.Option(help="Write a page of the map, its closures, and why.")] = None,
    out: Annotated[
        Path | None, typer.Option(help="Write the gated graph: in FILE's format where that holds one, else as g2o.")
    ] = None,
    out_values: Annotated[
        Path | None, typer.Option(help="Write the gated graph's optimum, where FILE is an archive.")
    ] = None,
    rejected: Annotated[
        Path | None, typer.Option(help="Write the closures that fail, a line each: the two identifiers in FILE.")
    ] = None,
    stream: Annotated[
        bool, typer.Option("--stream", help="Read lines of a running pipeline, answer each closure at once as JSON.")
    ] = False,
    socket: Annotated[
        Path | None, typer.Option(metavar="PATH", help="The same for any number of clients on this Unix socket.")
    ] = None,
    state: Annotated[
        Path | None,
        typer.Option(
            metavar="PATH",
            help="Keep the stream's map in this file, the maps of a socket's clients in this folder; go on from there.",
        ),
    ] = None,
) -> None:
    """Judge the loop closures of a graph, or of a pipeline.

    The gated graph is written without the closures that fail.
    """
    judge = _gate(edges, min_shared_landmarks, rule=rule, min_probability=min_probability, scores=scores)
    of_files = {"a FILE": file, "--values": values, "--loops": loops, "--one-map": one_map, "--cloud": cloud}
    of_files |= {"--ignore-unknown": ignore_unknown, "--every": every != 1, "--decisions": decisions, "--json": json}
    of_files |= {"--html": html, "--out": out, "--out-values": out_values, "--rejected": rejected}
    check_alone(of_files, state, socket, stream=stream)
    if socket is not None:
        return serve_socket(judge, radius, socket, state)
    if stream:
        return serve_standard_input(judge, radius, state)
    if not file:
        raise InvalidOptionError("expected a FILE, or --stream for the lines of a running pipeline, got neither")
    files = MapFiles(files=file, values=values, loops=loops, one_map=one_map, ignore_unknown=ignore_unknown)
    files.check_outputs([decisions, json, html, out, out_values, rejected], cloud)
    started = time.perf_counter()
    with counted() as tell:
        tell("reading", 0, 1)
        dataset, radii = read_map(files, radius, cloud, every)
        if out_values is not None and dataset.format not in ARCHIVES:
            raise InvalidOptionError(f"expected --out-values with a GTSAM archive, got {dataset.format}: use --out")

        # judge the closures
        gated = gate_graph(
            dataset.graph,
            dataset.values,
            radii,
            closures=dataset.closures,
            gate=judge,
            progress=lambda done, of: tell("judging closures", done, of),
        )
        records = decision_records(
            gated.decisions, _ends(dataset, gated.decisions), true_closures=dataset.true_closures
        )

        # write what was asked for
        options = _read_as(radius, cloud, edges, min_shared_landmarks, every)
        options |= {"rule": rule, "min_probability": min_probability}
        with outputs.together():
            written = _write_gated(dataset, gated, out, out_values)
            if decisions is not None:
                write_json_lines(records, decisions)
            if rejected is not None:
                _write_pairs(dataset, gated.rejected, rejected)
            _write_document(dataset, gated, records, options, json, html)

    # show it
    console = terminal()
    print_heading(dataset.title, f"{len(records)} loop closures, the surest judged first", dataset.notes, console)
    print_decisions(records, console)
    print_tally(records, console, seconds=time.perf_counter() - started)
    print_left_out(written.unwritten, "the gated graph's file", console)
    graph = f"gated graph, {written.surprise}" if written.surprise else "gated graph"
    paths = {"decisions": decisions, "JSON": json, "page": html, graph: out, "its values": out_values}
    print_paths({**paths, "rejected closures": rejected}, console)


def closures(
    file: Map,
    values: Values = None,
    loops: Loops = None,
    one_map: OneMap = False,
    ignore_unknown: IgnoreUnknown = False,
    radius: Radius = None,
    cloud: Cloud = None,
    edges: Edges = None,
    min_shared_landmarks: MinShared = None,
    every: Every = 1,
    json: Annotated[Path | None, typer.Option(help="Write every closure with its evidence to this JSON file.")] = None,
) -> None:
    """Judge each loop closure against all the others.

    Closures of a finished map are listed least probable first. A closure is taken out, the map optimised
    without that closure, and the closure offered to the gate. False closures that agree support each other
    here, and many bend the whole map: use `gate` for such maps.
    """
    files = MapFiles(files=file, values=values, loops=loops, one_map=one_map, ignore_unknown=ignore_unknown)
    files.check_outputs([json], cloud)
    started = time.perf_counter()
    with counted() as tell:
        tell("reading", 0, 1)
        dataset, radii = read_map(files, radius, cloud, every)

        # judge each of them
        judged, alone = leave_one_out(
            dataset.graph,
            dataset.values,
            radii,
            closures=dataset.closures,
            gate=_gate(edges, min_shared_landmarks),
            progress=lambda done, of: tell("judging closures", done, of),
        )
        records = decision_records(judged, _ends(dataset, judged), true_closures=dataset.true_closures)

        # write what was asked for
        if json is not None:
            options = _read_as(radius, cloud, edges, min_shared_landmarks, every)
            document = _document(dataset, records, alone, read_keyframes(dataset.values), "as the file has it", options)
            write_json(document, json)

    # show it
    console = terminal()
    print_heading(dataset.title, f"{len(records)} loop closures, each against all others", dataset.notes, console)
    print_closures(least_probable_first(records), console)
    print_tally(records, console, seconds=time.perf_counter() - started)
    if alone:
        print_left_out({"closures, on each of which a keyframe hangs alone": len(alone)}, "the judgement", console)
    print_paths({"JSON": json}, console)


def _write_document(
    dataset: Dataset,
    gated: GatedGraph,
    records: Sequence[Record],
    options: Mapping[str, Any],
    json: Path | None,
    html: Path | None,
) -> None:
    """Write decisions and map as JSON, as a page, or as both, if any."""
    if json is None and html is None:
        return
    keyframes = read_keyframes(gated.values)
    document = _document(dataset, records, [], keyframes, "at the optimum with the accepted closures", options)
    if json is not None:
        write_json(document, json)
    if html is not None:
        write_gate_page(document, html)


def _gate(edges: str | None, min_shared_landmarks: int | None, **options: Any) -> LoopClosureGate:
    shared = MIN_SHARED_LANDMARKS if min_shared_landmarks is None else min_shared_landmarks
    return LoopClosureGate(options=GateOptions(edges=split_names(edges), min_shared_landmarks=shared, **options))


def _read_as(
    radius: float | None, cloud: Path | None, edges: str | None, min_shared_landmarks: int | None, every: int
) -> dict[str, Any]:
    """How the map was read, for a document."""
    return {
        "radius": radius,
        "cloud": None if cloud is None else visible(cloud.name),
        "edges": split_names(edges),
        "min_shared_landmarks": min_shared_landmarks,
        "every": every,
    }


def _document(
    dataset: Dataset,
    records: Sequence[Record],
    unjudged: Sequence[int],
    keyframes: Keyframes,
    drawn: str,
    options: Mapping[str, Any],
) -> Record:
    """The closures and the map as JSON; `drawn` says where the keyframes are."""
    closing = {record["slot"] for record in records} | set(unjudged)
    return closures_document(
        records,
        name=dataset.title,
        file_format=dataset.format,
        notes=dataset.notes,
        options=options,
        unjudged=list(_ends(dataset, unjudged).values()),
        keyframes=keyframes,
        odometry=[each.ends for each in between_factors(dataset.graph) if each.slot not in closing],
        drawn=drawn,
    )


def _ends(dataset: Dataset, slots: Any) -> dict[int, list[int]]:
    """Keys of the keyframes of every closure, by slot."""
    return {slot: list(dataset.graph.at(slot).keys()) for slot in slots}


def _write_gated(dataset: Dataset, gated: GatedGraph, out: Path | None, out_values: Path | None) -> Outcome:
    """Write the gated graph, and on request its values."""
    if out_values is not None:
        gtsam_archive.write_archive(gated.values, out_values)
    return Outcome({}) if out is None else write_graph(dataset, gated.graph, gated.values, out)


def _write_pairs(dataset: Dataset, slots: Iterable[int], path: Path) -> None:
    """Write the ends of closures under their names in the map's file, a pair a line."""
    ends = _ends(dataset, slots).values()
    lines = [" ".join(dataset.names.get(key, str(key)) for key in keys) + "\n" for keys in ends]
    outputs.write_text(path, "".join(lines))
