"""Ctrl-C that comes while other people's code runs: it ends the command, and does not pass for an error of ours.

Compilers call back into Python, and what is raised there is dropped or becomes an error of theirs, half a library made.
"""

from __future__ import annotations

import _thread
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

AGAIN = 0.2  # s, after which an interrupt that was dropped is made again


@contextmanager
def notice_interrupts() -> Iterator[threading.Event]:
    """Yield an event that is set once the user has interrupted; an interrupt that was dropped comes again.

    In the main thread alone, and where nobody handles interrupts in a way of his own; else the event is never set.
    """
    seen = threading.Event()
    is_ours = threading.current_thread() is threading.main_thread()
    is_ours = is_ours and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if not is_ours:
        yield seen
        return

    def note(_number: int, _frame: FrameType | None) -> None:
        """Raise the interrupt that Python raises, and remember it."""
        seen.set()
        raise KeyboardInterrupt

    def drop(unraisable: sys.UnraisableHookArgs) -> None:
        """Make an interrupt again that could not be raised where it came; report anything else as before."""
        if unraisable.exc_type is not None and issubclass(unraisable.exc_type, KeyboardInterrupt):
            again.append(threading.Timer(AGAIN, _thread.interrupt_main))
            again[-1].daemon = True
            again[-1].start()
        else:
            report(unraisable)

    again: list[threading.Timer] = []
    report, sys.unraisablehook = sys.unraisablehook, drop
    signal.signal(signal.SIGINT, note)
    try:
        yield seen
    finally:
        for timer in again:
            timer.cancel()
        signal.signal(signal.SIGINT, signal.default_int_handler)
        sys.unraisablehook = report
