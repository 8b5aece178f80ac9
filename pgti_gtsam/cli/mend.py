"""`pgti-gtsam mend`: take wrong closures out, put closures in that the sensors confirm."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

from pgti_gtsam import datasets, outputs
from pgti_gtsam.adapter.values import read_keyframes
from pgti_gtsam.cli.mend_text import print_mended
from pgti_gtsam.cli.options import (
    Cloud,
    IgnoreUnknown,
    Map,
    MapFiles,
    OneMap,
    Radius,
    Values,
    print_paths,
    read_map,
    terminal,
)
from pgti_gtsam.cli.progress import counted
from pgti_gtsam.datasets.writer import write_graph
from pgti_gtsam.errors import InvalidOptionError
from pgti_gtsam.mending import clouds_in, scans_of
from pgti_gtsam.mending.exchange import open_ties, ties_in
from pgti_gtsam.mending.mending import mend as mended_map
from pgti_gtsam.plain_text import visible
from pgti_gtsam.report.document import write_json
from pgti_gtsam.report.mended import mended_document, write_mended_page


def mend(
    file: Map,
    values: Values = None,
    one_map: OneMap = False,
    ignore_unknown: IgnoreUnknown = False,
    radius: Radius = None,
    cloud: Cloud = None,
    clouds: Annotated[
        Path | None,
        typer.Option(help="Folder with one PCD or PLY file a keyframe, numbered as the keyframes or in their order."),
    ] = None,
    loops: Annotated[
        Path | None, typer.Option(help="Ties of a matcher or a human, as g2o: the gate judges them, nothing else.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Write the mended map: as FILE's format, or g2o where the name ends with .g2o.")
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would be done, and write no map.")] = False,
    proposals: Annotated[
        Path | None, typer.Option(help="Write ties that are wanted and not confirmed to this g2o file, as predicted.")
    ] = None,
    json: Annotated[Path | None, typer.Option(help="Write everything found to this JSON file.")] = None,
    html: Annotated[
        Path | None, typer.Option(help="Write a page with the map before and after, and all scans.")
    ] = None,
) -> None:
    """Mend a map: wrong closures out, confirmed closures in.

    The gate judges all closures; scans or clouds confirm new ones. FLIRTLib and CARMEN files bring their scans;
    clouds come by --clouds. Without either ties are only proposed.
    """
    files = MapFiles(files=file, values=values, one_map=one_map, ignore_unknown=ignore_unknown)
    files.check_outputs([out, proposals, json, html], cloud, loops)
    if out is None and not dry_run and proposals is None:
        raise InvalidOptionError("expected --out FIXED, or --dry-run to write no map, got neither")
    with counted() as tell:
        tell("reading", 0, 1)
        dataset, radii = read_map(files, radius, cloud)
        keys = read_keyframes(dataset.values).keys.tolist()
        mended = mended_map(
            dataset.graph,
            dataset.values,
            scans_of(dataset.scans) if clouds is None else clouds_in(clouds, keys),
            radii=radii,
            closures=dataset.closures,
            matched=[] if loops is None else ties_in(loops, dataset),
            progress=lambda step: tell(step, 0, 1),
        )
        document = mended_document(
            mended,
            dataset.graph,
            name=dataset.title,
            file_format=dataset.format,
            notes=dataset.notes,
            options={
                "radius": radius,
                "clouds": None if clouds is None else visible(clouds.name),
                "loops": None if loops is None else visible(loops.name),
                "dry_run": dry_run,
            },
            names=dataset.names,
        )

        # write what was asked for
        unwritten: Mapping[str, int] = {}
        with outputs.together():
            if out is not None and not dry_run:
                unwritten = write_graph(dataset, mended.graph, mended.values, out).unwritten
            if proposals is not None:
                graph, poses = open_ties(mended)
                datasets.write_g2o(graph, poses, proposals, names=dataset.names)
            if json is not None:
                write_json(document, json)
            if html is not None:
                write_mended_page(document, html)

    # show it
    console = terminal()
    print_mended(document, console)
    for what, count in unwritten.items():
        console.print(f"left out of the mended map's file: {count} {what}", style="yellow", markup=False)
    written = {"mended map": None if dry_run else out, "proposals": proposals, "JSON": json, "page": html}
    print_paths(written, console)
