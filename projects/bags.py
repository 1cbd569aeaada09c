"""Folders that tell by themselves whether all of them is still there: BagIt 1.0 (RFC 8493), hashes by SHA-256.

In goes a folder with its payload under `data/`; out come the files that make it a bag, or what a check of one finds.
What it holds is read by the Library of Congress' own library (`bagit`), not by the counterpart of what writes it.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import bagit

from projects.hdf5 import in_one_line
from projects.provenance import hash_file
from projects.verify import ERROR, WARNING, Finding, VerifyReport

PAYLOAD = "data"
DECLARATION = "bagit.txt"
ALGORITHM = "sha256"
MANIFEST = f"manifest-{ALGORITHM}.txt"
DECLARED = ("BagIt-Version: 1.0", "Tag-File-Character-Encoding: UTF-8")
_ESCAPED = {"%": "%25", "\r": "%0D", "\n": "%0A"}  # RFC 8493, section 2.1.3


def is_bag(path: Path) -> bool:
    """Return whether a folder says that it is a bag, or is one that lost the file which says so."""
    return (path / DECLARATION).is_file() or ((path / MANIFEST).is_file() and (path / PAYLOAD).is_dir())


def write_bag(folder: Path, about: Mapping[str, str]) -> tuple[int, int]:
    """Make a bag of a folder whose payload lies under `data/`; return the payload's number of files and of bytes.

    Parameters
    ----------
    folder : holds `data/` and nothing else.
    about : labels and texts of `bag-info.txt`, in order; the size of the payload is added.
    """
    payload = [p for p in sorted((folder / PAYLOAD).rglob("*")) if p.is_file()]
    n_bytes = sum(p.stat().st_size for p in payload)
    _write(folder / MANIFEST, _manifest(folder, payload))
    _write(folder / DECLARATION, DECLARED)
    labels = {**about, "Payload-Oxum": f"{n_bytes}.{len(payload)}"}
    _write(folder / "bag-info.txt", [f"{label}: {' '.join(text.split())}" for label, text in labels.items()])
    tags = [p for p in sorted(folder.iterdir()) if p.is_file()]
    _write(folder / f"tagmanifest-{ALGORITHM}.txt", _manifest(folder, tags))
    return len(payload), n_bytes


def verify_bag(path: Path) -> VerifyReport:
    """Return what a check of every file against its hash finds; what cannot be read as a bag is a finding too.

    Every file at fault is named: the library's own validation ends at the first kind of fault.
    """
    logging.getLogger(bagit.__name__).setLevel(logging.CRITICAL)  # it tells again what it raises
    if not (path / DECLARATION).is_file():
        told = f"{DECLARATION} is missing: restore it from a copy, or write it anew, of the lines {DECLARED[0]!r} and "
        return VerifyReport((Finding(ERROR, DECLARATION, f"{told}{DECLARED[1]!r}; then verify again"),), 0, 0)
    if links := tuple(_links(path)):  # the library follows them
        return VerifyReport(links, 0, 0)
    try:
        bag = bagit.Bag(str(path))
        findings = list(_faults(bag, path))
        if not any(f.severity == ERROR for f in findings):
            bag.validate(completeness_only=True)  # its structure and counts
    except (bagit.BagError, OSError, ValueError) as error:
        return VerifyReport((Finding(ERROR, DECLARATION, f"is not read as a bag: {in_one_line(error)}"),), 0, 0)
    n_bytes = sum(p.stat().st_size for p in (path / PAYLOAD).rglob("*") if p.is_file())
    return VerifyReport(tuple(findings), len(bag.entries), n_bytes)


def _links(path: Path) -> Iterator[Finding]:
    """Yield each symbolic link in a bag, whose bytes may lie elsewhere and stay behind when it is copied."""
    for link in sorted(p for p in path.rglob("*") if p.is_symlink()):
        name = link.relative_to(path).as_posix()
        yield Finding(ERROR, name, f"{name} is a symbolic link; put the file itself there, then verify again")


def _faults(bag: bagit.Bag, path: Path) -> Iterator[Finding]:
    """Yield each file that is missing, new or changed."""
    seal = f"tagmanifest-{ALGORITHM}.txt"
    if not (path / seal).is_file():  # RFC 8493 does not ask for one
        yield Finding(
            WARNING, seal, f"{seal} is missing, so nobody knows whether bag-info.txt and the manifest changed"
        )
    missing, unexpected = (sorted(names) for names in bag.compare_manifests_with_fs())
    for name in missing:
        yield Finding(ERROR, name, f"{name} is missing")
    for name in unexpected:
        yield Finding(ERROR, name, f"{name} was not there when it was archived")
    for name, hashes in sorted(bag.entries.items()):
        if name in missing:
            continue
        if ALGORITHM not in hashes:
            yield Finding(ERROR, name, f"{name} has no {ALGORITHM} hash")
        elif hash_file(path / name) != hashes[ALGORITHM].lower():
            yield Finding(ERROR, name, f"{name} has changed since it was archived: its SHA-256 is not the one recorded")


def _manifest(folder: Path, files: Iterable[Path]) -> list[str]:
    """Return a line for each file: its hash and its path in the folder."""
    return [f"{hash_file(path)}  {_escape(path.relative_to(folder).as_posix())}" for path in files]


def _escape(name: str) -> str:
    """Return a path as a manifest holds it."""
    return "".join(_ESCAPED.get(c, c) for c in name)


def _write(path: Path, lines: Iterable[str]) -> None:
    """Write lines of UTF-8, each ended by a line feed."""
    path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8", newline="\n")
