"""Which comparison a command means: the epochs REFERENCE and COMPARED as they were given, or none."""

from __future__ import annotations

from projects.errors import ParameterError
from projects.store import Project

Pair = tuple[str | None, str | None]  # the ids of REFERENCE and COMPARED, None where left out


def named_pair(project: Project, object_id: str, pair: Pair) -> tuple[str, str] | None:
    """Return the ids of the two epochs that were named, None where none was.

    Raises
    ------
    StoreError
        Where the project has no such object or epoch.
    ParameterError
        Where one epoch alone was named.
    """
    reference, compared = pair
    project.object(object_id)
    if reference and compared:
        return project.epoch(object_id, reference).epoch_id, project.epoch(object_id, compared).epoch_id
    if reference:
        raise ParameterError(f"one epoch was given ({reference}); give two, REFERENCE and COMPARED, or none")
    return None
