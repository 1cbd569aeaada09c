"""Run the papers' experiments and write VALIDATION.md: `python tests/validation/validate.py [NAME...]`.

    validate.py                  run the experiments in full, one after the other, and write VALIDATION.md;
                                 those that may take more than an hour only where they are named
    validate.py table_1 stove    run those only; the others keep their last result
    validate.py --small NAME...  run in small and print; nothing is kept, but with --keep, and then only where there
                                 is no full result
    validate.py --write          write VALIDATION.md from the results there are

An experiment is a file of `experiments/` with `TITLE`, `run(size) -> list[Row]` and, where wanted, `NOTES` (a
paragraph below the table) and `LIMIT` (seconds). Each runs in a process of its own, limited in time; one that fails
leaves its reason and does not stop the others. Results are kept in `results/`, the prose around them in `template.md`.
"""

from __future__ import annotations

import argparse
import datetime
import importlib
import importlib.metadata
import json
import os
import platform
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
EXPERIMENTS, RESULTS = HERE / "experiments", HERE / "results"
SCENES = ROOT / "tests" / "scenes"
DEFAULT_LIMIT = 900.0
LONG_LIMIT = 3600.0
SMALL_LIMIT = 400.0  # less than a minute on an idle machine
VERSIONS = ("heritage-monitor", "numpy", "scipy", "numba", "open3d-cpu", "open3d", "pymeshlab", "py4dgeo", "small-gicp")


def names_of_experiments() -> list[str]:
    """Return the names of the files of `experiments/`, in order."""
    return sorted(p.stem for p in EXPERIMENTS.glob("*.py"))


def load(name: str) -> Any:
    """Return the module of an experiment."""
    for folder in (HERE, EXPERIMENTS, SCENES):
        if str(folder) not in sys.path:
            sys.path.insert(0, str(folder))
    return importlib.import_module(name)


def run_here(name: str, size: str) -> dict[str, Any]:
    """Run one experiment in this process and return its result as plain values."""
    from rows import as_mapping

    experiment = load(name)
    started = time.perf_counter()
    rows = experiment.run(size)
    own, children = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    return {
        "rows": [as_mapping(row) for row in rows],
        "seconds": round(time.perf_counter() - started, 1),
        "cpu_seconds": round(own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime, 1),
        "peak_mib": round(max(own.ru_maxrss, children.ru_maxrss) / 1024),
    }


def run_in_child(name: str, size: str, limit: float) -> dict[str, Any]:
    """Run one experiment in a process of its own; a failure is a result with its reason."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "result.json"
        command = [sys.executable, str(Path(__file__).resolve()), "--child", str(out), "--size", size, name]
        environment = {
            "NUMBA_THREADING_LAYER": "omp",
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
        }
        child = subprocess.Popen(command, cwd=ROOT, env=environment, stderr=subprocess.PIPE, text=True,
                                 start_new_session=True)  # fmt: skip
        try:
            _, said = child.communicate(timeout=limit)
        except subprocess.TimeoutExpired:
            os.killpg(child.pid, signal.SIGKILL)
            child.communicate()
            return {"error": f"stopped after {limit:.0f} s"}
        if out.is_file():
            return dict(json.loads(out.read_text()))
        if child.returncode < 0:
            return {"error": f"killed by {signal.Signals(-child.returncode).name}", "trace": said}
        last = [line for line in (said or "").splitlines() if line.strip()][-1:]
        return {"error": last[0] if last else f"ended with code {child.returncode}", "trace": said}


def with_origin(name: str, size: str, result: dict[str, Any]) -> dict[str, Any]:
    """Return a result with when, from what and by which command it was made."""
    versions = {"python": platform.python_version()}
    for package in VERSIONS:
        try:
            versions[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            continue
    return {
        "experiment": name,
        "size": size,
        "command": f"python tests/validation/validate.py {'--small ' if size == 'small' else ''}{name}",
        "date": datetime.date.today().isoformat(),
        "commit": commit_of_code(),
        "machine": f"{os.cpu_count()} cores, {platform.machine()}, {platform.system()}",
        "versions": versions,
        **result,
    }


def commit_of_code() -> str:
    """Return the commit that runs, "-dirty" where more than results and their page differ from it."""

    def ask(*words: str) -> str:
        return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True).stdout.strip()

    changed = ask("status", "--porcelain", "--", ".", f":!{RESULTS.relative_to(ROOT)}", ":!VALIDATION.md")
    return (ask("describe", "--always") or "unknown") + ("-dirty" if changed else "")


def names_in_an_hour() -> list[str]:
    """Return the experiments that run where none is named."""
    return [name for name in names_of_experiments() if getattr(load(name), "LIMIT", DEFAULT_LIMIT) <= LONG_LIMIT]


def has_full_result(name: str) -> bool:
    """Return whether a result in full is kept that did not fail."""
    path = RESULTS / f"{name}.json"
    kept = json.loads(path.read_text()) if path.is_file() else {}
    return kept.get("size") == "full" and "error" not in kept


def run_all(names: Sequence[str], size: str, keep: bool) -> int:
    """Run experiments one by one, keep and print what they found; return how many failed."""
    n_failed = 0
    for name in names:
        print(f"{name} ...", flush=True)
        limit = getattr(load(name), "LIMIT", DEFAULT_LIMIT) if size == "full" else SMALL_LIMIT
        result = with_origin(name, size, run_in_child(name, size, limit))
        trace = result.pop("trace", None)
        if "error" in result:
            n_failed += 1
            print(f"  failed: {result['error']}\n{trace or ''}", flush=True)
        for row in result.get("rows", []):
            beside = "; ".join(f"{k}: {v}" for k, v in row.get("others", {}).items())
            print(f"  {row['verdict']:8} {row['what']}: {row['ours']}   (asked {row.get('asked', '-')}) {beside}")
        print(f"  {result.get('seconds', '-')} s, CPU {result.get('cpu_seconds', '-')} s", flush=True)
        if keep and (size == "full" or not has_full_result(name)):
            RESULTS.mkdir(exist_ok=True)
            (RESULTS / f"{name}.json").write_text(json.dumps(result, indent=1, ensure_ascii=False) + "\n")
    return n_failed


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what the command line names."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help="experiments; all that take less than an hour where none is named")
    parser.add_argument("--small", action="store_true", help="run in small, print, keep nothing")
    parser.add_argument("--keep", action="store_true", help="keep also what ran in small")
    parser.add_argument("--write", action="store_true", help="only write VALIDATION.md from the results kept")
    parser.add_argument("--list", action="store_true", help="list the experiments")
    parser.add_argument("--child", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--size", default="full", help=argparse.SUPPRESS)
    given = parser.parse_args(arguments)
    unknown = set(given.names) - set(names_of_experiments())
    if unknown:
        parser.error(f"no experiment {', '.join(sorted(unknown))}; there are {', '.join(names_of_experiments())}")
    if given.child:
        given.child.write_text(json.dumps(run_here(given.names[0], given.size)))
        return 0
    if given.list:
        print("\n".join(f"{name:16} {load(name).TITLE}" for name in names_of_experiments()))
        return 0
    from validation_page import write_page

    n_failed = 0
    if not given.write:
        size, keep = ("small", given.keep) if given.small else ("full", True)
        n_failed = run_all(given.names or names_in_an_hour(), size, keep)
    if given.keep or not given.small:
        write_page(ROOT / "VALIDATION.md", HERE / "template.md", RESULTS, {n: load(n) for n in names_of_experiments()})
    return 1 if n_failed else 0


if __name__ == "__main__":
    sys.path.insert(0, str(HERE))
    sys.exit(main())
