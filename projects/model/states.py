"""What is said of a point: changed or not, why it could not be assessed, how rough it is."""

from __future__ import annotations

from enum import IntEnum


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
    UNEXPLAINED = 9  # surfaces or points differ by more than errors do, over too little, on one side, beside a step
    MET_NOTHING = 10  # the other epoch's scans hold nothing in that direction: gone, dark, hidden by it, or cut out


class Roughness(IntEnum):
    """Roughness class of a point: surface variation against what noise alone gives at that neighbourhood size."""

    SMOOTH = 0
    MEDIUM = 1
    ROUGH = 2
