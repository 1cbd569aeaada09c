"""The nouns: plain frozen dataclasses that every package speaks of.

Metres, radians and float64 in local coordinates; unknown is NaN. A cloud or surface is never changed in
place: `take` and `dataclasses.replace` make new ones. Signed distances are positive where material was gained.
"""

from projects.arrays import Bools as Bools
from projects.arrays import Floats as Floats
from projects.arrays import Ints as Ints
from projects.model.clouds import PointCloud as PointCloud
from projects.model.clouds import Scan as Scan
from projects.model.comparisons import REGION_COLUMNS as REGION_COLUMNS
from projects.model.comparisons import Z95 as Z95
from projects.model.comparisons import ComparedSurface as ComparedSurface
from projects.model.comparisons import Comparison as Comparison
from projects.model.records import EpochRecord as EpochRecord
from projects.model.records import ObjectRecord as ObjectRecord
from projects.model.records import Step as Step
from projects.model.registrations import Registration as Registration
from projects.model.required import require_noun as require_noun
from projects.model.series import CLOSURE_COLUMNS as CLOSURE_COLUMNS
from projects.model.series import FORECAST_COLUMNS as FORECAST_COLUMNS
from projects.model.series import HISTORY_COLUMNS as HISTORY_COLUMNS
from projects.model.series import MOTION_COLUMNS as MOTION_COLUMNS
from projects.model.series import SERIES_COLUMNS as SERIES_COLUMNS
from projects.model.series import Series as Series
from projects.model.states import Assessment as Assessment
from projects.model.states import NotAssessed as NotAssessed
from projects.model.states import Roughness as Roughness
from projects.model.surfaces import Surface as Surface
from projects.model.survey import ControlPoint as ControlPoint
from projects.model.survey import SurveyTarget as SurveyTarget
