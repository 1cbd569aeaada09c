"""Says what has changed between two epochs: distances, level of detection, states, regions."""

from monitor.comparison.distances import normal_distances
from monitor.comparison.epochs import CompareSettings, compare
from monitor.comparison.level_of_detection import lague_lod95, level_of_detection

__all__ = ["CompareSettings", "compare", "lague_lod95", "level_of_detection", "normal_distances"]
