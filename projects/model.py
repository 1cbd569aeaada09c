"""The nouns: plain frozen dataclasses that every package speaks of.

Metres, radians and float64 in local coordinates; unknown is NaN. A cloud or surface is never changed in
place: `take` and `dataclasses.replace` make new ones. Signed distances are positive where material was gained.
"""

from __future__ import annotations

import dataclasses
import datetime
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from projects.arrays import Bools as Bools
from projects.arrays import Floats as Floats
from projects.arrays import Ints as Ints
from projects.arrays import hold_array
from projects.errors import ParameterError, ShapeError


class Assessment(IntEnum):
    """State of a point of a comparison (exported as the uchar property `assessment`)."""

    NOT_ASSESSABLE = 0
    UNCHANGED = 1
    CHANGED = 2


class NotAssessed(IntEnum):
    """Why a point is not assessable; 0 where it is."""

    ASSESSED = 0
    NO_FACE = 1  # the other surface comes within the search limit, but no face of it there looks the same way
    FREE_EDGE = 2  # the foot of the perpendicular falls on a boundary of the other surface
    SHEET_BETWEEN = 3  # the perpendicular crosses another sheet first
    TOO_UNCERTAIN = 4  # no level of detection, one above its limit, or the points do not bear the difference out
    NOT_SEEN = 5  # one epoch's scanners did not look there, or met something where the other's surface is missing
    BEYOND_SEARCH = 6  # no face of the other surface at all within the search limit
    LOOKED_THROUGH = 7  # changed: a scan of the other epoch looked through it; no perpendicular
    NO_ONE_SURFACE = 8  # in both epochs' mean most of what was measured there lies off the surface
    UNEXPLAINED = 9  # surfaces or points differ by more than errors do, over too little to be told, or on one side
    MET_NOTHING = 10  # the other epoch's scans hold nothing in that direction: gone, dark, hidden by it, or cut out


class Roughness(IntEnum):
    """Roughness class of a point: surface variation against what noise alone gives at that neighbourhood size."""

    SMOOTH = 0
    MEDIUM = 1
    ROUGH = 2


def require_noun(value: Any, what: str, *nouns: type) -> None:
    """Raise `ParameterError` where the value, which stands for `what`, is none of the nouns."""
    if not isinstance(value, nouns):
        names = " or ".join(noun.__name__ for noun in nouns)
        raise ParameterError(f"{what} is a {type(value).__name__}; a {names} is needed")


@dataclass(frozen=True)
class PointCloud:
    """Points with what is known of each.

    Attributes
    ----------
    points : (n, 3) float64, m.
    normals : (n, 3) float64, unit vectors towards the side from which the point was seen; NaN where unknown.
    origins : (n, 3) or (3,) float64, m, position of the scanner that measured the point, in the frame of `points`.
    sigma : (n,) float64, m, one sigma of the point along its normal.
    intensity : (n,) float32, 0 to 1.
    colors : (n, 3) uint8, red, green, blue.
    scan_index : (n,) int32, which scan of the epoch the point comes from.
    n_merged : (n,) int32, how many measurements the point stands for.
    spread : (n,) float64, m, robust one-sigma spread along the normal of the measurements merged into it.
    surface_variation : (n,) float64, lambda3 / (lambda1 + lambda2 + lambda3), Pauly et al. 2002.
    roughness : (n,) uint8, `Roughness`.
    spacing : (n,) float64, m, distance to neighbouring measurements before thinning.
    """

    points: Floats
    normals: Floats | None = None
    origins: Floats | None = None
    sigma: Floats | None = None
    intensity: Floats | None = None
    colors: NDArray[np.uint8] | None = None
    scan_index: Ints | None = None
    n_merged: Ints | None = None
    spread: Floats | None = None
    surface_variation: Floats | None = None
    roughness: NDArray[np.uint8] | None = None
    spacing: Floats | None = None

    def __post_init__(self) -> None:
        hold_array(self, "points", (None, 3), np.float64)
        n = len(self.points)
        is_shared = self.origins is not None and np.ndim(self.origins) == 1
        hold_array(self, "normals", (n, 3), np.float64)
        hold_array(self, "origins", (3,) if is_shared else (n, 3), np.float64)
        hold_array(self, "colors", (n, 3), np.uint8)
        kinds = {"sigma": np.float64, "intensity": np.float32, "scan_index": np.int32, "n_merged": np.int32,
                 "spread": np.float64, "surface_variation": np.float64, "roughness": np.uint8,
                 "spacing": np.float64}  # fmt: skip
        for name, kind in kinds.items():
            hold_array(self, name, (n,), kind)

    def __len__(self) -> int:
        return len(self.points)

    def incidence_cosines(self) -> Floats:
        """Return the cosine (n,) of the angle between each point's normal and its beam; 1 where that is not known."""
        if self.origins is None or self.normals is None:
            return np.ones(len(self))
        beams = self.origins - self.points
        cosines = np.abs(np.einsum("ij,ij->i", beams, self.normals)) / np.linalg.norm(beams, axis=1)
        return np.asarray(np.where(np.isfinite(cosines), cosines, 1.0))

    def take(self, which: Bools | Ints) -> PointCloud:
        """Return the points selected by a mask or by indices, with all that is known of them."""
        picked = {}
        for f in dataclasses.fields(self):
            value = getattr(self, f.name)
            shared = f.name == "origins" and value is not None and value.ndim == 1
            picked[f.name] = value if value is None or shared else value[which]
        return PointCloud(**picked)


@dataclass(frozen=True)
class Scan:
    """One instrument set-up: measured points in the scanner's own frame, and where it stood.

    `cloud.points` are in the scan's frame; `origin` is the scanner's position in that frame (0 0 0 for nearly
    every instrument); `pose` is T_project_scanner (4, 4). `rows` and `columns` are -1 or absent where the scan is
    not a grid. `dropped` counts what was not a measurement, by reason.
    """

    name: str
    cloud: PointCloud
    pose: Floats
    origin: Floats = field(default_factory=lambda: np.zeros(3))
    rows: Ints | None = None
    columns: Ints | None = None
    scanner: str | None = None
    dropped: Mapping[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n = len(self.cloud)
        hold_array(self, "pose", (4, 4), np.float64)
        hold_array(self, "origin", (3,), np.float64)
        hold_array(self, "rows", (n,), np.int32)
        hold_array(self, "columns", (n,), np.int32)

    def take(self, which: Bools | Ints) -> Scan:
        """Return the scan with only the points selected."""
        rows = None if self.rows is None else self.rows[which]
        columns = None if self.columns is None else self.columns[which]
        return dataclasses.replace(self, cloud=self.cloud.take(which), rows=rows, columns=columns)


@dataclass(frozen=True)
class Surface:
    """A triangle mesh with what is known of each vertex.

    Attributes
    ----------
    vertices : (n, 3) float64, m.
    faces : (m, 3) int32, counter-clockwise seen from outside (from where the scanners stood).
    normals : (n, 3) float64, outward unit normals.
    sigma : (n,) float64, m, one sigma of the vertex along its normal; NaN where it cannot be stated.
    sigma_shared : (n,) float64, m, one sigma of the error that a whole neighbourhood shares: what the scans of the
        epoch disagree by and how well they are placed. NaN where nothing tells either, absent where it was not looked
        for.
    n_support : (n,) int32, how many samples the vertex rests on.
    sample_distance : (n,) float64, m, distance to the nearest sample.
    stray_share : (n,) float32, share of the points measured around the vertex that lie off the surface; NaN where there
        are none, absent where it was not looked for.
    roughness : (n,) uint8, `Roughness` of the nearest samples.
    colors, intensity : as of `PointCloud`.
    is_unresolved : (n,) bool, vertices beside a place left open because two sheets come nearer each other there than
        the cells of the surface tell apart; absent where there are none.
    is_crest : (n,) bool, vertices on the line where two sides of an edge or fold meet, their normals the mean of both;
        absent where there are none.
    face_invented : (m,) bool, faces that close holes where nothing was measured; absent where there are none.
    """

    vertices: Floats
    faces: Ints
    normals: Floats | None = None
    sigma: Floats | None = None
    sigma_shared: Floats | None = None
    n_support: Ints | None = None
    sample_distance: Floats | None = None
    stray_share: Floats | None = None
    roughness: NDArray[np.uint8] | None = None
    colors: NDArray[np.uint8] | None = None
    intensity: Floats | None = None
    is_unresolved: Bools | None = None
    is_crest: Bools | None = None
    face_invented: Bools | None = None

    def __post_init__(self) -> None:
        hold_array(self, "vertices", (None, 3), np.float64)
        hold_array(self, "faces", (None, 3), np.int32)
        n, faces = len(self.vertices), self.faces
        if len(faces) and (faces.min() < 0 or faces.max() >= n):
            raise ShapeError(f"faces name vertices {faces.min()} to {faces.max()}; the surface has 0 to {n - 1}")
        hold_array(self, "normals", (n, 3), np.float64)
        hold_array(self, "colors", (n, 3), np.uint8)
        hold_array(self, "face_invented", (len(faces),), np.bool_)
        kinds = {"sigma": np.float64, "sigma_shared": np.float64, "n_support": np.int32, "sample_distance": np.float64,
                 "stray_share": np.float32, "roughness": np.uint8, "intensity": np.float32, "is_unresolved": np.bool_,
                 "is_crest": np.bool_}  # fmt: skip
        for name, kind in kinds.items():
            hold_array(self, name, (n,), kind)


@dataclass(frozen=True)
class Registration:
    """The motion that brings a source onto a target, and how well it is known.

    Attributes
    ----------
    T_target_source : (4, 4) float64, rigid; maps coordinates of the source to those of the target.
    covariance : (6, 6) float64, rad and m, of (w, t) in x -> c + exp([w]) (x - c) + t, a left perturbation applied
        after `T_target_source` about `centre` c.
    centre : (3,) float64, m, in the target's frame.
    converged : whether the motion settled; nothing may be built on one that did not.
    reason : why it did not converge, in words.
    n_inliers : pairs of points that were held to be unmoved.
    n_correspondences : pairs of points that look the same way near each other.
    n_iterations : steps taken.
    rmse : m, root mean square of the inliers' residuals, the signed distances of a pair along the target's normal.
    sigma : m, 1.4826 times the median size of the residuals of the stable pairs.
    overlap : share of the samples of the source that found a partner.
    stable_share : share of these that was held to be unmoved.
    is_stable : (n,) bool, which points or vertices of the source were held to be unmoved.
    weights : (n,) float64, the share that each of them has of all weight in the adjustment that falls on points or
        vertices, robust weights counted: what the motion rests on. What is held unmoved and hardly fits has little.
    held_by_frames : names, in words, the motions that the shape does not hold and that stay as the frames of both sides
        say, with the uncertainty of those.
    doubt : says in words what speaks against the stable areas being stable, or against this pose beside others that fit
        as well; empty where nothing does.
    layer : m, the thickness by which the stable areas of the source all lie outside of the target, beside which the
        motion was found; NaN where none is told.
    sigma_layer : m, one sigma of it, in which scans disagree as if all together; NaN where none is told.
    stable_is_rest : most of the source lies off by one thickness, and the stable areas are the rest, which alone did
        not change.
    scale : how many times as large the source is as the target, which the motion leaves in the differences; NaN where
        no other scale than 1 is told.
    sigma_scale : one sigma of it; NaN where none is told.
    """

    T_target_source: Floats
    covariance: Floats
    centre: Floats
    converged: bool
    reason: str = ""
    n_inliers: int = 0
    n_correspondences: int = 0
    n_iterations: int = 0
    rmse: float = float("nan")
    sigma: float = float("nan")
    overlap: float = float("nan")
    stable_share: float = float("nan")
    is_stable: Bools | None = None
    weights: Floats | None = None
    held_by_frames: str = ""
    doubt: str = ""
    layer: float = float("nan")
    sigma_layer: float = float("nan")
    stable_is_rest: bool = False
    scale: float = float("nan")
    sigma_scale: float = float("nan")

    def __post_init__(self) -> None:
        hold_array(self, "T_target_source", (4, 4), np.float64)
        hold_array(self, "covariance", (6, 6), np.float64)
        hold_array(self, "centre", (3,), np.float64)


@dataclass(frozen=True)
class ComparedSurface:
    """One side of a comparison: a surface in the reference epoch's coordinates and the change at each vertex.

    `distances` [m], perpendicular to the other surface, are positive where material was gained, on both sides. Where
    the vertices of that surface have fitted normals and a sigma, it bows between the corners of a face as the normals
    say; to the flat face it is up to the bow more or less. `distances` and `lod95` [m] are NaN where `assessment` is
    NOT_ASSESSABLE, and `reasons` (`NotAssessed`) says why. Where a vertex is CHANGED because a scan of the other epoch
    looked through it (reason LOOKED_THROUGH), it is gone, or new, as a whole: `distances` is then that to the nearest
    point of the other surface in any direction, and `lod95` the median of the side.
    `region` is 0 outside of regions. A region also holds vertices that are NOT_ASSESSABLE, where what hangs together
    with its changed vertices lies outside or inside of the other surface without a perpendicular, as a piece that broke
    off and its fracture do: its area is that of all of them, the mean of both sides, but of a piece that is gone, or
    came, as a whole that of its own surface, before a loss and after a gain.
    `told_from` [m] float32, NaN where not assessed, is from about how large a mean change of the place of a vertex, as
    wide as errors agree or less, on it is told, in 19 of 20 cases: what its patch needs to be significant among all
    patches, and more where the surfaces guess what lies between their points. Where it is more than `coarse_from` [m]
    "unchanged" says much less than on most of the surface. None and NaN: not known.
    """

    surface: Surface
    distances: Floats
    lod95: Floats
    assessment: NDArray[np.uint8]
    region: Ints
    reasons: NDArray[np.uint8]
    told_from: Floats | None = None
    coarse_from: float = float("nan")

    @property
    def is_coarse(self) -> Bools:
        """Which vertices (n,) are unchanged as far as can be told, where only much larger changes are told."""
        if self.told_from is None:
            return np.zeros(len(self.assessment), dtype=np.bool_)
        return np.asarray((self.assessment == Assessment.UNCHANGED) & (self.told_from > self.coarse_from))

    @property
    def is_changed(self) -> Bools:
        """Which vertices (n,) have changed."""
        return np.asarray(self.assessment == Assessment.CHANGED)

    @property
    def changed_region(self) -> Ints:
        """The region (n,) of each vertex that has changed, 0 elsewhere."""
        return np.where(self.is_changed, self.region, 0).astype(np.int32)


REGION_COLUMNS = ("region", "kind", "area_m2", "sigma_area_m2", "volume_m3", "sigma_volume_m3", "extreme_m",
                  "sigma_extreme_m", "mean_m", "sigma_mean_m", "x", "y", "z")  # fmt: skip


@dataclass(frozen=True)
class Comparison:
    """What changed between two epochs, where, how much and how sure.

    `on_compared` and `on_reference` hold the change at the vertices of the later and of the earlier surface, both in
    the reference epoch's coordinates. `registration` is of the compared epoch onto the reference; in the `mode`
    "relative" its motion was removed, in "absolute" it stays in the differences. `regions` is a table with the columns
    `REGION_COLUMNS`, largest first. Where the registration tells a layer all over, regions are what stands out of it,
    and their figures are beside it, as the statistic `lod95_beside_layer_median_m` says by being there; distances and
    `lod95` are with it. `statistics` holds the figures of the summary file (`stable_share`,
    `bias_m`, `nmad_m`, `rmse_m`, `lod95_median_m`, `n_vertices`, `n_not_assessable`, `n_unchanged`, `n_changed`,
    `share_above_lod95`, `motion_significance`, ...); `motion_significance` is NaN, and `motion_is_significant` None,
    where it is not known how far the frames of both epochs may differ; `told_by_width_m` has rows of how wide [m] a
    change is and from how large a mean change [m] on one so wide is told in 19 of 20 cases, the median over the
    surface.
    """

    on_compared: ComparedSurface
    on_reference: ComparedSurface
    regions: pd.DataFrame
    registration: Registration
    mode: str
    statistics: Mapping[str, Any]


SERIES_COLUMNS = ("identity", "first_seen", "last_seen", "parent", "merged_into", "area_m2", "model",
                  "rate_m_per_year", "sigma_rate_m_per_year", "p_rate", "acceleration_m_per_year2",
                  "sigma_acceleration_m_per_year2", "p_acceleration", "p_onset", "onset_from_years", "onset_to_years",
                  "p_fit", "x", "y", "z", "found_by", "volume_rate_m3_per_year",
                  "sigma_volume_rate_m3_per_year")  # fmt: skip
HISTORY_COLUMNS = ("identity", "epoch", "years", "region", "event", "mean_m", "sigma_mean_m", "change_m3",
                   "sigma_change_m3")  # fmt: skip
FORECAST_COLUMNS = ("identity", "years", "mean_m", "sigma_m")
MOTION_COLUMNS = ("epoch", "years", "shift_m", "sigma_shift_m", "turn_rad", "sigma_turn_rad", "probability_unmoved",
                  "x_m", "y_m", "z_m", "sigma_x_m", "sigma_y_m", "sigma_z_m")  # fmt: skip
CLOSURE_COLUMNS = ("reference", "compared", "misfit_sigma")


@dataclass(frozen=True)
class Series:
    """What goes on over several epochs, on the surface of their reference epoch.

    `reference_id` and `reference_date` (ISO) name that epoch; `epoch_ids`, `dates` (ISO) and `years` (k,) since then
    are of the epochs compared with it. Over the n vertices of the reference surface: `rate`, `sigma_rate` [m/year],
    `acceleration`, `sigma_acceleration` [m/year2], NaN where unknown, positive = gained, and `identity`, the followed
    region (0: none). `regions` (`SERIES_COLUMNS`) has a row for each followed region, `history` (`HISTORY_COLUMNS`) one
    for each of them in each epoch, measured over its whole footprint: `change_m3` is its mean change times its area, as
    much larger as the region's volume is where that is largest. Of a region `found_by` its "trend" no single epoch
    shows anything, and `first_seen` and `last_seen` are empty; others were found by "epochs", or "both". `forecast`
    (`FORECAST_COLUMNS`) says for regions with a trend which mean difference an epoch at a time should show if it goes
    on as before. `motions` (`MOTION_COLUMNS`) says how the object stood as a whole in each epoch against the first,
    from one adjustment of all registrations, its `probability_unmoved` NaN where it is not known how far the frames of
    both may differ, `closures` (`CLOSURE_COLUMNS`) how well each of them fits it; empty where there was no such
    network.
    `rate_assessment` (n,) is the `Assessment` of each vertex's rate: CHANGED where it is significant, with false
    discoveries held over the surface and over patches of every size, so that one vertex's rate over its sigma does not
    decide; NOT_ASSESSABLE where fewer than two epochs tell one; None where an older program left it open.
    `rate_told_from` (n,) float32 [m/year], NaN where not assessed, is from about how large a rate on one is told, of a
    place as wide as errors agree, in 19 of 20 cases; more where surfaces guess what lies between their points.
    `statistics` hold its median (`told_from_median_m_per_year`), beyond how large a rate a place that tells none
    smaller is coarse (`coarse_from_m_per_year`), which share of the assessed area is (`coarse_area_share`), and from
    how large a rate on nearly all of that tells one (`coarse_told_from_m_per_year`); empty of older programs.
    """

    reference_id: str
    reference_date: str
    epoch_ids: tuple[str, ...]
    dates: tuple[str, ...]
    years: Floats
    rate: Floats
    sigma_rate: Floats
    acceleration: Floats
    sigma_acceleration: Floats
    identity: Ints
    regions: pd.DataFrame
    history: pd.DataFrame
    forecast: pd.DataFrame
    motions: pd.DataFrame = field(default_factory=lambda: pd.DataFrame(columns=list(MOTION_COLUMNS)))
    closures: pd.DataFrame = field(default_factory=lambda: pd.DataFrame(columns=list(CLOSURE_COLUMNS)))
    rate_assessment: NDArray[np.uint8] | None = None
    rate_told_from: Floats | None = None
    statistics: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "epoch_ids", tuple(self.epoch_ids))
        object.__setattr__(self, "dates", tuple(self.dates))
        hold_array(self, "years", (len(self.dates),), np.float64)
        n = len(np.atleast_1d(self.rate))
        for name in ("rate", "sigma_rate", "acceleration", "sigma_acceleration"):
            hold_array(self, name, (n,), np.float64)
        hold_array(self, "identity", (n,), np.int32)
        hold_array(self, "rate_assessment", (n,), np.uint8)
        hold_array(self, "rate_told_from", (n,), np.float32)


@dataclass(frozen=True)
class ControlPoint:
    """A point, known by its `name`, of known `position` (3,) [m] in the project's frame; `sigma` [m] is that of each
    coordinate, NaN where it was not stated."""

    name: str
    position: Floats
    sigma: float = float("nan")


@dataclass(frozen=True)
class SurveyTarget:
    """A sphere or a black-and-white board found in a scan.

    Attributes
    ----------
    kind : "sphere" or "board".
    centre : (3,) m, of the sphere, or where the four fields of the board meet, in the scan's frame.
    covariance : (3, 3) m2, of the centre.
    radius : m, of the sphere; half the width of the board.
    residual : m, root mean square distance of its points from sphere or plane.
    n_points : measurements that it rests on.
    completeness : share of what should have been seen of it.
    name : of the control point that it is, empty where unknown.
    """

    kind: str
    centre: Floats
    covariance: Floats
    radius: float
    residual: float
    n_points: int
    completeness: float
    name: str = ""

    def __post_init__(self) -> None:
        hold_array(self, "centre", (3,), np.float64)
        hold_array(self, "covariance", (3, 3), np.float64)


@dataclass(frozen=True)
class ObjectRecord:
    """The monitored thing as the archive knows it: its id, and free texts.

    `extent` is where it stands in the project's frame, as of `projects.extent`; `tolerance` [m] the client's own limit.
    `front` [rad] is the bearing to which its front faces, clockwise from +y of the project's frame, from 0 to below
    2 pi; None: nobody said. Of a room that is the wall ahead.
    """

    object_id: str
    name: str = ""
    inventory: str = ""
    place: str = ""
    material: str = ""
    description: str = ""
    extent: Mapping[str, Any] | None = None
    tolerance: float | None = None
    front: float | None = None


@dataclass(frozen=True)
class EpochRecord:
    """The state of an object at one date, from one or more scans or from one finished mesh (`is_mesh`).

    `scanner` is a preset of the instruments, where one was named; with `repeated` the scans are of one station, to be
    averaged. `sources` name the files: see `projects/FORMAT.md`. `control` are the points that hold the epoch's frame.
    `unit` [m] is what the numbers of its files were taken for; None: not known.
    """

    object_id: str
    epoch_id: str
    date: datetime.date
    label: str = ""
    scanner: str | None = None
    repeated: bool = False
    is_mesh: bool = False
    operator: str = ""
    sources: tuple[Mapping[str, Any], ...] = ()
    control: tuple[ControlPoint, ...] = ()
    unit: float | None = None


@dataclass(frozen=True)
class Step:
    """One product and how it came to be: identified by the hash of what was asked of which inputs.

    `parameters` are the settings asked for; `automatic` the values that were found; `counts` what went in, came out
    and was dropped with its reason; `inputs` the step ids or file hashes it was made from; `versions` the programs;
    `created` is ISO 8601 in UTC, and `seconds` how long it took.
    """

    step_id: str
    product: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    inputs: tuple[str, ...] = ()
    automatic: Mapping[str, Any] = field(default_factory=dict)
    counts: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    created: str = ""
    seconds: float = float("nan")
