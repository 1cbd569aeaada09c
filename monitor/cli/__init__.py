"""The command `monitor`: speaks with the user, in millimetres and degrees; everything else is done elsewhere.

Exit codes: 0, 2 for a user's error (one clear line on stderr), 1 for ours, 130 when interrupted.
"""

from __future__ import annotations

import errno
import io
import sys
import traceback
import warnings
from collections.abc import Sequence
from threading import Event

from monitor.cli.app import app
from monitor.cli.interrupts import notice_interrupts
from projects.errors import MonitorError

INTERRUPTED = 130
FULL = (errno.ENOSPC, errno.EDQUOT)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and end the process with its exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a name that the output has no letters for is told with their numbers
            stream.reconfigure(errors="backslashreplace")
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in arguments
    arguments = [a for a in arguments if a != "--debug"]
    sys.exit(run(arguments, debug))


def run(arguments: list[str], debug: bool = False) -> int:
    """Run one command and return its exit code; with `debug`, errors come with their traceback before their line."""
    warnings.filterwarnings("ignore", message="The TBB threading layer")  # numba has others; not the user's concern
    with notice_interrupts() as interrupted:
        return _run(arguments, debug, interrupted)


def _run(arguments: list[str], debug: bool, interrupted: Event) -> int:
    """Run one command and return its exit code; once `interrupted`, an error that is not the user's comes of that."""
    try:
        code = app(arguments, prog_name="monitor", standalone_mode=False)
    except KeyboardInterrupt:
        code = INTERRUPTED
    except MonitorError as error:
        if debug:
            traceback.print_exc()
        _complain(str(error))
        return 2
    except Exception as error:  # noqa: BLE001 - the last place that can turn it into one line
        return _interrupted() if interrupted.is_set() else _usage_or_ours(error, debug)
    if code == INTERRUPTED:  # which typer makes of it, too
        return _interrupted()
    return code if isinstance(code, int) else 0


def _usage_or_ours(error: Exception, debug: bool) -> int:
    """Return 2 for a wrong command line, 1 for an error of ours."""
    if type(error).__name__ == "Abort":
        return _interrupted()
    if type(error).__name__ == "NoArgsIsHelpError":
        sys.stderr.write(f"{error}\n")  # what may be asked
        return 2
    if hasattr(error, "format_message"):
        command = getattr(getattr(error, "ctx", None), "command_path", "monitor")
        _complain(f"{error.format_message()} (see: {command} --help)")
        return 2
    if debug:
        traceback.print_exception(error)
    if isinstance(error, OSError) and error.errno in FULL:
        _complain(f"{error.strerror}: make room on the disk; what was finished is kept, and the same command goes on")
        return 2
    _complain(f"an error of ours, not yours: {type(error).__name__}: {error}; run again with --debug and report it")
    return 1


def _interrupted() -> int:
    """Say that the command was interrupted, and return its code."""
    _complain("interrupted; what was finished is kept, and the same command goes on from there")
    return INTERRUPTED


def _complain(message: str) -> None:
    """Write one line to stderr."""
    line = " ".join(message.split())
    sys.stderr.write(f"monitor: {line}\n")
