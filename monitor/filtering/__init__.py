"""From raw scans to a thinned cloud: robust normals, outliers, silhouettes, roughness, thinning to the mode, merge."""

from monitor.filtering.averaging import AveragedScan, AveragingSettings, average_scans
from monitor.filtering.calibration import Calibration, CalibrationSettings, calibrate_range, correct_range
from monitor.filtering.diffusion import DiffusionSettings, diffuse
from monitor.filtering.merging import merge_scans
from monitor.filtering.normals import NormalSettings, estimate_normals
from monitor.filtering.scan import FilterResult, FilterSettings, filter_scan, filter_scan_with_record
from monitor.filtering.silhouettes import SilhouetteSettings
from monitor.filtering.thinning import ThinningSettings
from monitor.filtering.voxel_median import VoxelMedianSettings, voxel_median
from monitor.kernel_cache import prepare_cache

prepare_cache()

__all__ = [
    "AveragedScan",
    "AveragingSettings",
    "Calibration",
    "CalibrationSettings",
    "DiffusionSettings",
    "FilterResult",
    "FilterSettings",
    "NormalSettings",
    "SilhouetteSettings",
    "ThinningSettings",
    "VoxelMedianSettings",
    "average_scans",
    "calibrate_range",
    "correct_range",
    "diffuse",
    "estimate_normals",
    "filter_scan",
    "filter_scan_with_record",
    "merge_scans",
    "voxel_median",
]
