"""Survey targets found in a scan without a click: spheres of usual radii, and black-and-white boards.

In: a `Scan` as it was measured. Out: `SurveyTarget`s in the scan's own frame, each with the covariance of its centre.
`papers/002`: spherical and planar targets of about 10 cm, detected automatically.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from monitor.declare import check_settings, given_or_default, setting
from monitor.registration.targets.angular_image import make_image
from monitor.registration.targets.boards import BoardRules, find_boards
from monitor.registration.targets.spheres import SphereRules, find_spheres
from projects.errors import ParameterError
from projects.model import Scan, SurveyTarget

USUAL_RADII = (0.05, 0.06985, 0.0725, 0.0762, 0.1)  # m: 100, 139.7, 145, 152.4 and 200 mm across


@dataclass(frozen=True, kw_only=True)
class TargetSettings:
    """Survey targets that are looked for in the scans."""

    search: str = setting(
        "controlled", unit="", meaning="look for spheres and boards; controlled: where an epoch has control points",
        choices=("controlled", "always", "never"),
    )  # fmt: skip
    sphere_radius: float | None = setting(
        None, unit="m", low=0.005, high=1.0, meaning="of the spheres; 50, 69.85, 72.5, 76.2 and 100 mm"
    )
    smallest_board: float = setting(0.05, unit="m", low=0.01, meaning="width of the smallest black-and-white board")
    largest_board: float = setting(0.4, unit="m", low=0.02, meaning="width of the largest black-and-white board")
    completeness: float = setting(0.5, unit="", low=0.1, high=1.0, meaning="least share of a target that must be seen")
    roughness: float = setting(
        2.0, unit="", low=1.0, meaning="largest residual of a target, as a multiple of the noise of its points"
    )
    size: float = setting(0.015, unit="", low=0.0, high=0.1, meaning="largest error of a sphere's radius, as a share")

    def __post_init__(self) -> None:
        check_settings(self)
        if self.smallest_board > self.largest_board:
            raise ParameterError(
                f"TargetSettings.smallest_board = {self.smallest_board:g} exceeds largest_board = "
                f"{self.largest_board:g}; set a smaller one, or the other larger"
            )


def find_targets(scan: Scan, settings: TargetSettings | None = None) -> tuple[SurveyTarget, ...]:
    """Find the survey targets in a scan.

    Parameters
    ----------
    scan : as measured from one station, in its own frame, not thinned. Rows and columns are used where it has them;
        boards are found only where it has intensity.

    Returns
    -------
    tuple of SurveyTarget
        Centres in the scan's frame, nearest first, with covariances of what the residuals show: noise, and noise that
        neighbours share. A range error common to the whole target (cyclic errors, a wrong radius) is not in them.

    Notes
    -----
    False ones are refused by size (the radius fitted freely must be a usual one; a board that goes on is a floor), by
    completeness, by residuals larger than the noise of single points, and, for spheres, by not standing free.
    """
    settings = given_or_default(settings, TargetSettings)
    image = make_image(scan)
    if image is None:
        return ()
    radii = USUAL_RADII if settings.sphere_radius is None else (settings.sphere_radius,)
    spheres = find_spheres(image, SphereRules(radii, settings.completeness, settings.roughness, settings.size))
    boards = find_boards(
        image,
        BoardRules(0.5 * settings.smallest_board, 0.5 * settings.largest_board, settings.completeness,
                   settings.roughness),
    )  # fmt: skip
    found = sorted([*spheres, *boards], key=lambda t: float(t.centre @ t.centre))
    return tuple(dataclasses.replace(t, centre=t.centre + scan.origin) for t in found)
