"""Says what has changed between two epochs: distances, level of detection, states, regions; and over more of them.

One direction: `distances` of two surfaces, what stations had in `sight`, the `noise`, `detection`, `regions`; `epochs`
puts them together for two epochs, `series` for more.
"""

from monitor.comparison.distances.perpendicular import normal_distances
from monitor.comparison.epochs import CompareSettings, compare
from monitor.comparison.m3c2 import M3C2Result, m3c2
from monitor.comparison.noise.level_of_detection import lague_lod95, level_of_detection
from monitor.comparison.series.epoch_change import EpochChange
from monitor.comparison.series.follow import follow

__all__ = [
    "CompareSettings", "EpochChange", "M3C2Result", "compare", "follow", "lague_lod95", "level_of_detection", "m3c2",
    "normal_distances",
]  # fmt: skip
