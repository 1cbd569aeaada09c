"""The command serve: a local page to browse a project, for as long as the command runs."""

from __future__ import annotations

import sys
from pathlib import Path
from socketserver import ThreadingMixIn
from typing import Any
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer, make_server

import typer

from projects.errors import ParameterError
from projects.store import Project
from reports.site import Site

ADDRESS = "127.0.0.1"  # this machine alone


class _Server(ThreadingMixIn, WSGIServer):
    """A server that answers while it draws."""

    daemon_threads = True

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of a browser that went away; tell any other error."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


class _Quiet(WSGIRequestHandler):
    """A handler that tells nothing of each request."""

    def log_message(self, format: str, *args: object) -> None:
        """Say nothing."""


def open_server(path: Path, port: int) -> WSGIServer:
    """Return a server of a project's pages on this machine, at a free port where `port` is 0.

    Raises
    ------
    ParameterError
        If the port is taken or may not be used.
    """
    Project.open(path)
    try:
        return make_server(ADDRESS, port, Site(path), server_class=_Server, handler_class=_Quiet)
    except OSError as error:
        raise ParameterError(
            f"--port {port}: cannot be used ({error.strerror}); leave it out, and a free one is taken"
        ) from error


def serve_project(path: Path, port: int) -> None:
    """Serve a project until the command is interrupted, which is its usual end."""
    with open_server(path, port) as server:
        typer.echo(f"{path} can be browsed at http://{ADDRESS}:{server.server_port}/ until this is ended with Ctrl-C")
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            typer.echo("ended")
