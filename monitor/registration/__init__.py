"""Brings scans and epochs onto each other, and says how well: motion, covariance, stable areas."""

from monitor.registration.icp import IcpSettings, register
from monitor.registration.propagation import propagate
from monitor.registration.significance import MotionSignificance, motion_significance

__all__ = ["IcpSettings", "MotionSignificance", "motion_significance", "propagate", "register"]
