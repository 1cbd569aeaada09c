"""What may be set of the surface; each default needs no thought.

Lengths in metres, or in cells of the surface where the name ends so.
"""

from __future__ import annotations

from dataclasses import dataclass

from monitor.declare import check_settings, setting
from projects.errors import ParameterError


@dataclass(frozen=True, kw_only=True)
class SurfaceSettings:
    """How a surface is made of points. Lengths in metres."""

    method: str = setting(
        "localized",
        unit="",
        meaning="engine of the raw surface; open3d to compare with",
        choices=("localized", "open3d"),
    )
    cell_size: float | None = setting(
        None, unit="m", meaning="edge of a cell; auto: 1.5 spacings, or 0.7 sigma of noise if larger", low=1e-6, high=10
    )  # fmt: skip
    trim_cells: float = setting(
        2.5, unit="cells", meaning="the surface ends at this distance from the samples", low=0.5, high=20
    )  # fmt: skip
    narrowest_fit_cells: float = setting(
        1.5, unit="cells", meaning="smallest radius of the points that a vertex is brought onto", low=1, high=20
    )  # fmt: skip
    widest_fit_cells: float = setting(
        24.0, unit="cells", meaning="largest radius of the points that a vertex is brought onto", low=1, high=100
    )  # fmt: skip
    noise_share: float = setting(
        0.03, unit="", meaning="standard error of a vertex, in sigmas of noise, below which no wider fit is tried",
        low=0.001, high=1
    )  # fmt: skip
    along_furrows: bool = setting(
        False, unit="", meaning="whether fits lie along furrows and edges: less noise, but faint changes smear there"
    )  # fmt: skip
    sharp_edges: bool = setting(
        True, unit="", meaning="whether edges and folds between two sides are kept sharp where the points show them"
    )  # fmt: skip
    tool_marks: bool = setting(
        True, unit="", meaning="whether relief that repeats, as the marks of tools do, is followed by waves"
    )  # fmt: skip
    close_holes: float = setting(
        0.0, unit="m", meaning="holes up to this width are closed by invented faces; 0: none", low=0, high=1000
    )  # fmt: skip
    watertight: bool = setting(
        False, unit="", meaning="whether all holes are closed by invented faces, the underside of an object too"
    )  # fmt: skip
    crumb_cells: float = setting(
        5.0, unit="cells", meaning="pieces smaller than a disc of this radius are dropped", low=0, high=1000
    )  # fmt: skip

    def __post_init__(self) -> None:
        check_settings(self)
        if self.narrowest_fit_cells > self.widest_fit_cells:
            raise ParameterError(
                f"SurfaceSettings.narrowest_fit_cells = {self.narrowest_fit_cells:g} exceeds "
                f"widest_fit_cells = {self.widest_fit_cells:g}; set a smaller one, or the other larger"
            )
