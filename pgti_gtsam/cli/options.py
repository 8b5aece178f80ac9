"""What several commands share: options, the check of outputs, the bar."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from pgti_gtsam.adapter import EDGE_SOURCES
from pgti_gtsam.errors import InvalidOptionError

File = Annotated[
    Path | None,
    typer.Argument(
        help="Map: g2o, TORO, GTSAM archive, KITTI stereo, CARMEN or FLIRTLib log. Default: KITTI 00 from GTSAM.",
        show_default=False,
    ),
]
Values = Annotated[
    Path | None, typer.Option("--values", help="Archive of the values, where FILE is an archived graph.")
]
Radius = Annotated[float | None, typer.Option(help="Free distance around every keyframe, in metres.")]
Cloud = Annotated[Path | None, typer.Option(help="Point cloud or mesh: radii are the distances to it (needs Open3D).")]
Edges = Annotated[
    str | None,
    typer.Option(
        help=f"What connects keyframes, from {','.join(EDGE_SOURCES)}. Default: the first two; "
        "all three where radii do not come from landmarks or no landmarks are shared."
    ),
]
MinShared = Annotated[int, typer.Option(help="Landmarks that two keyframes must share to be connected.")]
Beta = Annotated[float, typer.Option(help="Share of the time scales that counts as local.")]


def check_output(output: Path | None, inputs: list[Path]) -> None:
    """Refuse an output that cannot be written, or that would overwrite what is read."""
    if output is None:
        return
    if any(path.exists() and output.exists() and path.samefile(output) for path in inputs):
        raise InvalidOptionError(f"expected an output of its own, got the input {output}; name another file")
    if output.is_dir() or not output.parent.is_dir():
        raise InvalidOptionError(f"expected a file in an existing folder, got {output}")


@contextmanager
def stages(count: int) -> Iterator[Callable[[str], None]]:
    """A bar on standard error that moves by stages and vanishes when done."""
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("starting", total=count)

        def stage(description: str) -> None:
            progress.update(task, description=description, advance=1)

        yield stage
