"""Names on disks that take upper and lower case for one, as those of Windows and macOS do.

In: paths of a project, and what its index names. Out: which names lead to one file, or an error where an id would take
the folder of another.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path, PurePosixPath

from projects.errors import StoreError


def is_named(root: Path, path: Path, by_folded: dict[str, str]) -> bool:
    """Return whether a file is one of those named, under its own name or, on such a disk, in another case.

    Parameters
    ----------
    root : folder of the project; path : a file in it that is there.
    by_folded : the names relative to the project, by `fold_names`.
    """
    name = path.relative_to(root).as_posix()
    named = by_folded.get(name.casefold())
    return named is not None and (named == name or ((root / named).exists() and path.samefile(root / named)))


def fold_names(names: Collection[str]) -> dict[str, str]:
    """Return names by what a disk that takes upper and lower case for one makes of them."""
    return {name.casefold(): name for name in names}


def require_own_folder(root: Path, folder: PurePosixPath, what: str) -> None:
    """Raise `StoreError` where the folder of a new id lies there already in another case.

    Parameters
    ----------
    root : folder of the project; folder : of the new id, relative to it; what : words for it, "epoch 'e1'".
    """
    above = root / folder.parent
    there = sorted(p.name for p in above.iterdir()) if above.is_dir() else []
    other = next((n for n in there if n != folder.name and n.casefold() == folder.name.casefold()), None)
    if other is not None:
        raise StoreError(
            f"{what}: the folder {above / other} is left of one that was removed, and some disks take upper and lower "
            "case for one; choose another id, write it as that folder is named, or delete what was removed with: "
            "monitor remove-epoch --purge"
        )
