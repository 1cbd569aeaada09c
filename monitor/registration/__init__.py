"""Brings scans and epochs onto each other, and says how well: motion, covariance, stable areas.

One direction: the `motion` of one surface onto another, survey `targets`, the `network` of an epoch's scans, scans from
`anywhere`; `parts` that moved, and `epochs`, which chooses how two of them are registered.
"""

from monitor.registration.motion.icp import IcpSettings, register
from monitor.registration.motion.propagation import propagate
from monitor.registration.motion.significance import MotionSignificance, motion_significance

__all__ = ["IcpSettings", "MotionSignificance", "motion_significance", "propagate", "register"]
