"""Ctrl-C at whatever moment: one line, exit code 130, no traceback."""

from __future__ import annotations

import contextlib
import ctypes
import signal
import time
from collections.abc import Iterator
from typing import Any

import pytest

from monitor import cli

LINE = "monitor: interrupted; what was finished is kept, and the same command goes on from there\n"


@pytest.fixture(autouse=True)
def _interrupts_as_python_has_them() -> Iterator[None]:
    """A shell that puts tests into the background has them ignore interrupts."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def running(monkeypatch: pytest.MonkeyPatch, work: Any) -> int:
    """Return the exit code of a command that does such work."""
    monkeypatch.setattr(cli, "app", lambda *_args, **_named: work())
    return cli.run([])


def test_what_fails_because_of_an_interrupt_is_no_error_of_ours(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def compile_half() -> None:
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        raise RuntimeError("no compiled object yet")

    assert running(monkeypatch, compile_half) == 130
    assert capfd.readouterr().err == LINE


def test_an_interrupt_that_was_dropped_comes_again(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    @ctypes.CFUNCTYPE(None)
    def called_back() -> None:
        signal.raise_signal(signal.SIGINT)

    def work() -> None:
        called_back()  # type: ignore[call-arg]
        for _ in range(100):
            time.sleep(0.05)

    assert running(monkeypatch, work) == 130
    assert capfd.readouterr().err == LINE
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_interrupt_that_was_dropped_does_not_outlive_the_command(monkeypatch: pytest.MonkeyPatch) -> None:
    @ctypes.CFUNCTYPE(None)
    def called_back() -> None:
        signal.raise_signal(signal.SIGINT)

    def work() -> None:
        called_back()  # type: ignore[call-arg]
        raise RuntimeError("no compiled object yet")

    assert running(monkeypatch, work) == 130
    time.sleep(0.4)  # or a KeyboardInterrupt comes here


def test_an_error_without_an_interrupt_stays_one(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def fail() -> None:
        raise RuntimeError("no compiled object yet")

    assert running(monkeypatch, fail) == 1
    assert "an error of ours, not yours: RuntimeError: no compiled object yet" in capfd.readouterr().err
