"""From the points of an epoch to its surface, with the uncertainty of every vertex.

`reconstruct(cloud)` is the door; `surface_to_points` judges the surface by the scans it came from.
"""

from monitor.reconstruction.distances import surface_to_points
from monitor.reconstruction.surface import ReconstructionResult, reconstruct, reconstruct_with_record
from monitor.reconstruction.surface_settings import SurfaceSettings

__all__ = ["ReconstructionResult", "SurfaceSettings", "reconstruct", "reconstruct_with_record", "surface_to_points"]
