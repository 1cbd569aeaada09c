"""Is a project whole? Every file of the index is there with its bytes, and what else lies in the folder is named."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from projects.atomic import PARTIAL, is_being_written
from projects.errors import MonitorError
from projects.identifiers import PRODUCT_FILE_PATTERN, object_folder
from projects.index import Index, all_products
from projects.index_file import INDEX_NAME, read_index
from projects.letter_case import fold_names, is_named
from projects.lock import LOCK_NAME, is_stale, is_unfinished, read_owner
from projects.products import open_product, require_bytes, stored_step
from projects.records import to_json

ERROR, WARNING, NOTE = "error", "warning", "note"


@dataclass(frozen=True)
class Finding:
    """Something about a project that is not as it should be: an error loses or falsifies results, a warning may, a
    note only informs. `path` is relative to the project."""

    severity: str
    path: str
    message: str


@dataclass(frozen=True)
class VerifyReport:
    """What a check of a project found; `ok` where nothing is lost or changed."""

    findings: tuple[Finding, ...]
    n_files: int
    n_bytes: int

    @property
    def ok(self) -> bool:
        """Whether no finding is an error."""
        return all(f.severity != ERROR for f in self.findings)


def verify_project(path: Path, progress: Callable[[str, int], None] | None = None) -> VerifyReport:
    """Return what a check of the project folder finds; an unreadable index is a finding too, not an exception."""
    try:
        index = read_index(path / INDEX_NAME)
    except MonitorError as error:
        return VerifyReport((Finding(ERROR, INDEX_NAME, str(error)),), 1, 0)
    findings: list[Finding] = []
    products = all_products(index)
    for epoch, entry in products:
        try:
            require_bytes(path, entry, f"{epoch.object_id} {epoch.epoch_id} {entry.step.product}")
            with open_product(path, epoch, entry) as file:
                if to_json(stored_step(file)) != to_json(entry.step):
                    findings.append(Finding(ERROR, entry.file, "its step is not the one that the index holds"))
        except MonitorError as error:
            findings.append(Finding(ERROR, entry.file, str(error)))
        if progress is not None:
            progress(entry.file, entry.n_bytes)
    findings += _unnamed(path, index)
    return VerifyReport(tuple(findings), len(products) + 1, sum(entry.n_bytes for _, entry in products))


def _unnamed(root: Path, index: Index) -> Iterator[Finding]:
    """Yield a finding for each thing in the folder that the index does not name."""
    named = fold_names({INDEX_NAME, *(entry.file for _, entry in all_products(index))})
    for path in sorted(root.rglob("*")):
        name = path.relative_to(root).as_posix()
        if path.is_symlink():
            is_error = named.get(name.casefold()) == name
            yield Finding(ERROR if is_error else WARNING, name, "is a symbolic link; a project holds none")
        elif not path.is_dir() and not is_named(root, path, named):
            yield _judge(path, name)


def _judge(path: Path, name: str) -> Finding:
    """Return what a file is that the index does not name."""
    if name == LOCK_NAME:
        owner = read_owner(path)
        if owner is not None and (is_stale(owner) or is_unfinished(path)):
            return Finding(WARNING, name, "was left by a process that is gone; the next writer removes it")
        return Finding(NOTE, name, "the project is being written now")
    if name.startswith(f"{PARTIAL}/") and is_being_written(path):
        return Finding(NOTE, name, "is being written now")
    if name.startswith((f"{PARTIAL}/", f"{LOCK_NAME}.")):
        return Finding(WARNING, name, "was left by an interrupted writer; the next writer removes it")
    if _is_product_file(name):
        return Finding(NOTE, name, "is of a removed epoch (remove-epoch --purge deletes it) or was made anew since")
    return Finding(WARNING, name, "is not part of the project")


def _is_product_file(name: str) -> bool:
    """Return whether a name is that of a file of a product."""
    parts = name.split("/")
    return len(parts) == 4 and parts[0] == "objects" and bool(PRODUCT_FILE_PATTERN.fullmatch(parts[3]))


def delete_unnamed(
    root: Path, index: Index, object_id: str | None, is_meant: Callable[[str], bool] = lambda name: True
) -> list[Path]:
    """Delete product files that the index does not name, and folders that are empty then; return the files.

    Of an object or of all, those whose names, relative to the project, are meant. Only what this program wrote goes:
    files of other names, and links, are left where they are.
    """
    named = fold_names({entry.file for _, entry in all_products(index)})
    folder = root / "objects" if object_id is None else root / object_folder(object_id)
    deleted = []
    for path in sorted(folder.rglob("*.h5")):
        name = path.relative_to(root).as_posix()
        is_ours = _is_product_file(name) and not path.is_symlink() and _is_inside(path, root)
        if is_ours and is_meant(name) and not is_named(root, path, named):
            path.unlink()
            deleted.append(path)
    for path in sorted(folder.rglob("*"), reverse=True):
        if path.is_dir() and not path.is_symlink():
            with suppress(OSError):  # not empty
                path.rmdir()
    return deleted


def _is_inside(path: Path, root: Path) -> bool:
    """Return whether a path leads to within the root."""
    return path.resolve().is_relative_to(root.resolve())
