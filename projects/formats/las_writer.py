"""Points out as LAS 1.4 or LAZ (by the file's suffix), with any further quantity as an extra dimension."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from projects.errors import FormatError, ShapeError
from projects.formats.complete_file import complete_file
from projects.model import Floats, PointCloud
from projects.reference_systems import wkt_of

CHUNK = 1_000_000
SCALES = (1e-6, 1e-5, 1e-4, 1e-3)  # m, the first that reaches across the points is taken
LARGEST = 2**31 - 1
LONGEST_NAME = 32
EXTRA_KINDS = "iuf"


def write_las(path: Path, cloud: PointCloud, extra: Mapping[str, NDArray[Any]] | None = None,
              about: Mapping[str, str] | None = None, crs: str = "") -> None:  # fmt: skip
    """Write points with intensity and colours where known, and extra dimensions such as `distance` and `lod95`.

    Parameters
    ----------
    path : .las, or .laz for the compressed form.
    cloud : at least one point, finite. Coordinates are stored as multiples of a micrometre about their middle (of
        0.01 mm where the points spread over more than 4 km). Unknown intensity becomes 0.
    extra : name (at most 32 letters) -> (n,) numbers; NaN stays NaN.
    about : name of an extra dimension -> what the file says of it (at most 32 letters), as its unit.
    crs : reference system of the points, as EPSG:n.

    Raises
    ------
    FormatError, ShapeError
        No points, points not finite or spread too far, an extra dimension that does not fit.
    """
    import laspy

    extra = {name: np.asarray(values) for name, values in (extra or {}).items()}
    if path.suffix.lower() not in (".las", ".laz"):
        raise FormatError(f"{path}: .las or .laz is needed")
    if not len(cloud) or not np.isfinite(cloud.points).all():
        raise FormatError(f"{path}: {len(cloud)} points, of which some are not finite; finite points are needed")
    header = laspy.LasHeader(version="1.4", point_format=6 if cloud.colors is None else 7)
    header.offsets = np.round((cloud.points.min(axis=0) + cloud.points.max(axis=0)) / 2, 3)
    header.scales = np.full(3, _scale(cloud.points, header.offsets, path))
    header.generating_software = "heritage-monitor"
    for name, values in extra.items():
        _require_fit(name, values, len(cloud))
        header.add_extra_dim(laspy.ExtraBytesParams(name, values.dtype, description=(about or {}).get(name, "")))
    words = wkt_of(crs)
    if words:
        header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(words))
        header.global_encoding.wkt = True
    with complete_file(path) as unfinished, laspy.open(unfinished, mode="w", header=header) as out:
        for start in range(0, len(cloud), CHUNK):
            which = slice(start, start + CHUNK)
            out.write_points(_record(cloud, extra, which, header))


def _scale(points: Floats, offsets: Floats, path: Path) -> float:
    """Return the finest step with which the points can be counted from the offset in 32 bits."""
    reach = float(np.abs(points - offsets).max())
    fits = [scale for scale in SCALES if reach / scale < LARGEST]
    if not fits:
        raise FormatError(f"{path}: points spread over {2 * reach:.3g} m; LAS cannot hold them to a millimetre")
    return fits[0]


def _require_fit(name: str, values: NDArray[Any], n: int) -> None:
    """Raise `ShapeError` where an extra dimension is not n numbers of a kind that LAS holds."""
    if len(name.encode()) > LONGEST_NAME or values.shape != (n,) or values.dtype.kind not in EXTRA_KINDS:
        raise ShapeError(f"extra dimension {name!r} is {values.dtype} {values.shape}; {n} numbers are needed")


def _record(cloud: PointCloud, extra: Mapping[str, NDArray[Any]], which: slice, header: Any) -> Any:
    """Return some of the points as LAS records."""
    import laspy

    points = cloud.points[which]
    record = laspy.ScaleAwarePointRecord.zeros(len(points), header=header)
    record.x, record.y, record.z = points.T
    record.return_number[:] = 1
    record.number_of_returns[:] = 1
    if cloud.intensity is not None:
        shares = np.clip(np.nan_to_num(cloud.intensity[which]), 0.0, 1.0)
        record.intensity = np.rint(shares * 65535).astype(np.uint16)
    if cloud.colors is not None:
        for k, name in enumerate(("red", "green", "blue")):
            record[name] = cloud.colors[which, k].astype(np.uint16) * 257
    for name, values in extra.items():
        record[name] = values[which]
    return record
