"""The command line: parse, call, print. The only place that catches `PgtiError`."""

from __future__ import annotations

import sys
from typing import Annotated

import typer
from rich.console import Console

from pgti_gtsam import __version__
from pgti_gtsam.cli.audit import audit, view
from pgti_gtsam.cli.diffusion import diffusion
from pgti_gtsam.cli.gate import closures, gate
from pgti_gtsam.cli.mend import mend
from pgti_gtsam.cli.options import READ_NOTES
from pgti_gtsam.cli.replay import replay
from pgti_gtsam.errors import PgtiError

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _tell_version(*, asked: bool) -> None:
    if asked:
        print(f"pgti-gtsam {__version__}")  # noqa: T201
        raise typer.Exit


@app.callback()
def describe(
    version: Annotated[
        bool, typer.Option("--version", callback=lambda asked: _tell_version(asked=asked), is_eager=True)
    ] = False,
) -> None:
    """Is this map right, and where not? Pose-graph topological integrity of SLAM maps."""


for _command in (audit, view, gate, closures, mend, replay, diffusion):
    app.command()(_command)


def main() -> None:
    """Run the command line; bad input ends with one line, and the notes on what was read, and exit code 2."""
    READ_NOTES.set(())
    try:
        app()
    except PgtiError as error:
        console = Console(stderr=True, highlight=False)
        console.print(f"pgti-gtsam: {error}", markup=False, soft_wrap=True)
        for note in (*READ_NOTES.get(), *getattr(error, "__notes__", ())):
            console.print(f"  note: {note}", markup=False, soft_wrap=True)
        sys.exit(2)
