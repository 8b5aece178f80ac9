"""`pgti-gtsam gate --stream` and `--socket`: a running pipeline on standard input, or several on a Unix socket."""

from __future__ import annotations

import os
import signal
import socket
import socketserver
import sys
from collections.abc import Mapping
from itertools import chain
from pathlib import Path
from typing import Any

import typer

from pgti_gtsam.cli.options import CLOSED_PIPE, discard_output
from pgti_gtsam.errors import InvalidOptionError, PgtiError
from pgti_gtsam.gate import LoopClosureGate
from pgti_gtsam.stream import Journal, Session, client_of, serve
from pgti_gtsam.stream.serving import tell

ENDING = (signal.SIGINT, signal.SIGTERM)


def check_alone(others: Mapping[str, Any], state: Path | None, address: Path | None, *, stream: bool) -> None:
    """Refuse options of files beside a stream, and options of a stream without a stream.

    Parameters
    ----------
    others : mapping
        Options of files, by name; true for given options.
    """
    if not stream and address is None:
        if state is not None:
            raise InvalidOptionError("expected --state with --stream or --socket, which it keeps, got it without")
        return
    given = next((name for name, value in others.items() if value), None)
    if given is not None:
        raise InvalidOptionError(f"expected a stream alone, got {given} too; files are for gate without --stream")
    if address is not None and stream:
        raise InvalidOptionError("expected --stream or --socket, got both: each client has a map of its own")


def serve_standard_input(gate: LoopClosureGate, radius_m: float | None, state: Path | None) -> None:
    """Answer the lines of standard input on standard output; exit code 141 where nobody reads the answers any more.

    Parameters
    ----------
    gate : LoopClosureGate
    radius_m : float, optional
        Metres around every keyframe; None where lines bring the radii.
    state : Path, optional
        File that keeps the map; None for a map that ends with the stream.
    """
    journal = None if state is None else Journal(state)
    session, first = (Session.started(gate, radius_m), []) if journal is None else journal.opened(gate, radius_m)
    try:
        tell(first, sys.stdout.buffer)
        serve(session, sys.stdin.buffer, sys.stdout.buffer, journal)
    except BrokenPipeError:
        discard_output()
        raise typer.Exit(CLOSED_PIPE) from None


def serve_socket(gate: LoopClosureGate, radius_m: float | None, path: Path, states: Path | None = None) -> None:
    """Answer any number of clients on a Unix socket, each with a map and a process of its own, until a signal ends it.

    Parameters
    ----------
    gate : LoopClosureGate
    radius_m : float, optional
        Metres around every keyframe; None where lines bring the radii.
    path : Path
        Name of the socket.
    states : Path, optional
        Folder that keeps the maps of clients that say their names, made where there is none.
    """
    _make_room(path)
    if states is not None:
        _make_folder(states)
    with _Server(str(path), gate, radius_m, states) as server:
        for number in ENDING:
            signal.signal(number, server.end)
        try:
            while not server.ends:
                server.handle_request()
        finally:
            for process in server.active_children or ():
                os.kill(process, signal.SIGTERM)
            path.unlink(missing_ok=True)


def _make_room(path: Path) -> None:
    """Remove a socket that an ended server left; refuse a socket in use, and any other file."""
    if not path.exists():
        return
    if not path.is_socket():
        raise InvalidOptionError(f"expected the name of a new socket, got the file {path}")
    with socket.socket(socket.AF_UNIX) as probe:
        try:
            probe.connect(str(path))
        except ConnectionRefusedError:
            path.unlink()
            return
    raise InvalidOptionError(f"expected a socket of this server alone, got {path}, which another one serves")


def _make_folder(path: Path) -> None:
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InvalidOptionError(
            f"expected --state with --socket as a folder, a file a client, got {path}: {error.strerror or error}"
        ) from error


class _Client(socketserver.StreamRequestHandler):
    """A client of a socket, in a process of its own, which a signal ends."""

    server: _Server

    def handle(self) -> None:
        self.server.socket.close()  # the parent's: nobody can connect any more when that has gone
        for number in ENDING:
            signal.signal(number, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)
        try:
            self._serve()
        except PgtiError as error:
            tell([{"line": 0, "error": str(error)}], self.wfile)
        except (BrokenPipeError, ConnectionResetError):  # the client has gone
            return

    def _serve(self) -> None:
        """Serve the client with a map of its own, kept under the client's name where it says one."""
        server, first = self.server, self.rfile.readline()
        name = client_of(first.decode("utf-8", "replace"))
        if name is None:
            serve(Session.started(server.gate, server.radius_m), chain([first], self.rfile), self.wfile)
            return
        if server.states is None:
            raise InvalidOptionError(f"expected lines of a map, got the name {name}: this server keeps no maps")
        journal = Journal(server.states / f"{name}.json")
        session, said = journal.opened(server.gate, server.radius_m)
        tell(said, self.wfile)
        serve(session, self.rfile, self.wfile, journal)


class _Server(socketserver.ForkingMixIn, socketserver.UnixStreamServer):
    """A process a client: none waits for another's decision."""

    timeout = 0.2  # s, after which it looks whether it is to end

    def __init__(self, path: str, gate: LoopClosureGate, radius_m: float | None, states: Path | None) -> None:
        super().__init__(path, _Client)
        self.gate, self.radius_m, self.states, self.ends = gate, radius_m, states, False

    def end(self, *_: object) -> None:
        """Take no more clients."""
        self.ends = True

    def process_request(self, request: Any, client_address: Any) -> None:
        """Fork; a signal waits until the client's process can handle the signal."""
        signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
        super().process_request(request, client_address)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)
