"""The command line: parse, call, print."""

from __future__ import annotations

from typing import Annotated

import typer

from pgti_gtsam import __version__
from pgti_gtsam.cli.audit import audit, view
from pgti_gtsam.cli.diffusion import diffusion
from pgti_gtsam.cli.ending import run_to_its_end
from pgti_gtsam.cli.fleet import compare
from pgti_gtsam.cli.gate import closures, gate
from pgti_gtsam.cli.mend import mend
from pgti_gtsam.cli.progress import with_verbosity
from pgti_gtsam.cli.replay import replay

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
        bool,
        typer.Option(
            "--version", help="Print the version.", callback=lambda asked: _tell_version(asked=asked), is_eager=True
        ),
    ] = False,
) -> None:
    """Is this map right, and where not? Pose-graph topological integrity of SLAM maps."""


for _command in (audit, view, compare, gate, closures, mend, replay, diffusion):
    app.command()(with_verbosity(_command))


def main() -> None:
    """Run the command line; an error ends the run with one line and exit code 2."""
    run_to_its_end(app)
