"""Says what has changed between two epochs: distances, level of detection, states, regions."""

from monitor.comparison.distances import normal_distances
from monitor.comparison.epochs import CompareSettings, compare
from monitor.comparison.level_of_detection import lague_lod95, level_of_detection
from monitor.comparison.m3c2 import M3C2Result, m3c2

__all__ = [
    "CompareSettings", "M3C2Result", "compare", "lague_lod95", "level_of_detection", "m3c2", "normal_distances",
]  # fmt: skip
