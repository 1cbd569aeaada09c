"""VALIDATION.md: the prose of `template.md` with the table of each experiment in its place.

A line `[[name]]` of the template stands for the table of that experiment, `[[summary]]` for the list of all. An
experiment that the template does not name comes at the end.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

MARK = re.compile(r"^\[\[(\w+)\]\]$", re.MULTILINE)


def write_page(target: Path, template: Path, results: Path, experiments: Mapping[str, Any]) -> None:
    """Write the page from the results kept."""
    kept = {p.stem: json.loads(p.read_text()) for p in sorted(results.glob("*.json")) if p.stem in experiments}
    text = template.read_text()
    named = set(MARK.findall(text))
    left = [name for name in experiments if name not in named]
    if left:
        text += "\n## More\n" + "".join(f"\n[[{name}]]\n" for name in left)

    def fill(mark: re.Match[str]) -> str:
        name = mark.group(1)
        if name == "summary":
            return summary(kept, experiments)
        if name not in experiments:
            raise KeyError(f"{template.name} names {name}; there is no such experiment")
        return section(name, kept.get(name), experiments[name])

    target.write_text(MARK.sub(fill, text))


def section(name: str, result: Mapping[str, Any] | None, experiment: Any) -> str:
    """Return title, command, table and notes of one experiment."""
    lines = [f"### {experiment.TITLE}", ""]
    if result is None:
        return "\n".join([*lines, f"Not run yet: `python tests/validation/validate.py {name}`."])
    lines += [origin(result), ""]
    if "error" in result:
        lines += [f"**failed: {result['error']}**"]
    else:
        lines += [*table(result["rows"])]
        causes = [f"- {row['what']}: {row['cause']}" for row in result["rows"] if row.get("cause")]
        lines += ["", "Not yet, because:", "", *causes] if causes else []
    notes = getattr(experiment, "NOTES", "")
    return "\n".join([*lines, "", notes] if notes else lines)


def origin(result: Mapping[str, Any]) -> str:
    """Return one line: command, time taken, date, commit."""
    cpu = f" (CPU {result['cpu_seconds']:.0f} s)" if "cpu_seconds" in result else ""
    took = f"{result['seconds']:.0f} s{cpu}, " if "seconds" in result else ""
    size = ", **in small**: too coarse for the bars, until it has run in full" if result.get("size") == "small" else ""
    return f"`{result['command']}`, {took}{result['date']}, {result['commit']}{size}."


def table(rows: list[Mapping[str, Any]]) -> list[str]:
    """Return the lines of a table; columns that are empty in all rows are left out."""
    others = list(dict.fromkeys(heading for row in rows for heading in row.get("others", {})))
    if not rows:
        return []
    columns = [("what", [row["what"] for row in rows])]
    for heading in ("paper", "asked", "ours"):
        columns.append((heading, [row.get(heading, "") for row in rows]))
    columns += [(heading, [row.get("others", {}).get(heading, "") for row in rows]) for heading in others]
    columns.append(("", [emphasize(row["verdict"]) for row in rows]))
    shown = [(heading, cells) for heading, cells in columns if any(cells)]
    lines = ["| " + " | ".join(heading for heading, _ in shown) + " |", "|" + "---|" * len(shown)]
    return lines + ["| " + " | ".join(cells[k] for _, cells in shown) + " |" for k in range(len(rows))]


def emphasize(verdict: str) -> str:
    """Return a verdict as it stands in a table."""
    return {"not yet": "**not yet**", "stated": ""}.get(verdict, verdict)


def summary(kept: Mapping[str, Mapping[str, Any]], experiments: Mapping[str, Any]) -> str:
    """Return a table of all experiments: rows passed, not yet, failed, and the time each took."""
    lines = ["| experiment | passed | not yet | time |", "|---|---|---|---|"]
    total = 0.0
    for name, experiment in experiments.items():
        result = kept.get(name)
        title = f"`{name}`: {experiment.TITLE}"
        if result is None:
            lines.append(f"| {title} | | not run | |")
            continue
        verdicts = [row["verdict"] for row in result.get("rows", [])]
        total += result.get("seconds", 0.0)
        title += " (in small)" if result.get("size") == "small" else ""
        not_yet = "failed" if "error" in result else str(verdicts.count("not yet"))
        lines.append(
            f"| {title} | {verdicts.count('pass')} | {not_yet} | {result.get('seconds', float('nan')):.0f} s |"
        )
    return "\n".join([*lines, f"| all | | | {total / 60.0:.0f} min |", "", *versions(kept)])


def versions(kept: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return a line for each set of versions that experiments ran with, the most common first, which needs no names."""
    found: dict[str, list[str]] = {}
    for name, result in kept.items():
        told = ", ".join(f"{package} {version}" for package, version in result.get("versions", {}).items())
        found.setdefault(told, []).append(f"`{name}`")
    ordered = sorted(found.items(), key=lambda item: -len(item[1]))
    return [
        f"Versions{'' if k == 0 else ' of ' + ', '.join(names)}: {told or 'unknown'}."
        for k, (told, names) in enumerate(ordered)
    ]
