"""What is in an archive, for machines: RO-Crate 1.2 metadata (JSON-LD) of a folder of files.

In: the folder, what each file is, and which files came of which. Out: `ro-crate-metadata.json` in it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from projects.model import ObjectRecord
from projects.provenance import hash_file

VERSION = "1.2"
FORMATS = {
    ".e57": "model/e57", ".ply": "PLY 1.0, binary little endian", ".obj": "model/obj", ".csv": "text/csv",
    ".txt": "text/plain", ".json": "application/json", ".html": "text/html",
    ".pdf": "application/pdf",
}  # fmt: skip
LICENCE = "No licence was recorded: ask who holds the rights in it before it is used or passed on."


@dataclass(frozen=True)
class Action:
    """A computation: its name, when it ended (ISO 8601), names of the files that went in and came out, programs with
    their versions."""

    name: str
    ended: str
    inputs: tuple[str, ...]
    results: tuple[str, ...]
    versions: Mapping[str, str]


def write_crate(
    folder: Path, title: str, subjects: Sequence[ObjectRecord], contents: Mapping[str, str], actions: Sequence[Action]
) -> None:
    """Write the metadata of a folder that is about `subjects`; `contents` holds each file's name and what it is."""
    from rocrate.rocrate import ROCrate

    crate = ROCrate(version=VERSION)
    crate.name = title
    crate.description = f"Documentation archive of {title}: scans, surfaces, comparisons and how each came to be."
    crate.root_dataset["license"] = LICENCE  # RO-Crate 1.2 asks for one; a text where nothing can be linked
    crate.root_dataset["about"] = [crate.add(_context(crate, f"#object-{r.object_id}", _subject(r))) for r in subjects]
    entities = {}
    for name, what in sorted(contents.items()):
        path = folder / name
        about = {
            "name": path.name, "description": what, "contentSize": str(path.stat().st_size),
            "sha256": hash_file(path), "encodingFormat": FORMATS.get(path.suffix, "application/octet-stream"),
        }  # fmt: skip
        entities[name] = crate.add_file(dest_path=name, properties=about)
    programs: dict[tuple[tuple[str, str], ...], Any] = {}
    for k, action in enumerate(actions, start=1):
        used = tuple(sorted(action.versions.items()))
        if used not in programs:
            programs[used] = crate.add(_context(crate, f"#program-{len(programs) + 1}", _program(action.versions)))
        crate.add_action(
            programs[used], f"#action-{k}", [entities[n] for n in action.inputs],
            [entities[n] for n in action.results], {"name": action.name, "endTime": action.ended},
        )  # fmt: skip
    crate.metadata.write(folder)


def _subject(record: ObjectRecord) -> dict[str, str]:
    """Return what is known of an object in the words of schema.org; what was not entered is left out."""
    known = {
        "name": record.name or record.object_id, "identifier": record.inventory, "material": record.material,
        "contentLocation": record.place, "description": record.description,
    }  # fmt: skip
    return {"@type": "VisualArtwork", **{name: text for name, text in known.items() if text}}


def _program(versions: Mapping[str, str]) -> dict[str, str]:
    """Return this program as it was, with what it ran on."""
    return {
        "@type": "SoftwareApplication", "name": "heritage-monitor",
        "softwareVersion": versions.get("heritage-monitor", "not recorded"),
        "softwareRequirements": ", ".join(f"{n} {v}" for n, v in versions.items() if n != "heritage-monitor"),
    }  # fmt: skip


def _context(crate: object, identifier: str, about: Mapping[str, str]) -> object:
    """Return an entity that is no file."""
    from rocrate.model.contextentity import ContextEntity

    return ContextEntity(crate, identifier, properties=dict(about))
