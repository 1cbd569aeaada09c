"""A laboratory with known truth: instruments, scenes and a scanner that measures them."""

from monitor.simulation.instruments import INSTRUMENTS, Instrument, without_errors
from monitor.simulation.scanner import Window, misregister, simulate_scan, stand_at, stream_scan, window_around
from monitor.simulation.scenes import Body, Scene, Truth, plane_scene, sphere_scene, step_scene, wave_scene

__all__ = [
    "INSTRUMENTS", "Body", "Instrument", "Scene", "Truth", "Window", "misregister", "plane_scene", "simulate_scan",
    "sphere_scene", "stand_at", "step_scene", "stream_scan", "wave_scene", "window_around", "without_errors",
]  # fmt: skip
