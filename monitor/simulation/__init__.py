"""A laboratory with known truth: instruments, scenes, a scanner that measures them, and the demo's campaign."""

from monitor.simulation.campaign import DemoCampaign, write_demo_campaign
from monitor.simulation.changes import TrueChange
from monitor.simulation.figure import CarvedFigure, carved_figure
from monitor.simulation.instruments import INSTRUMENTS, Instrument, without_errors
from monitor.simulation.relief import relief_scene
from monitor.simulation.scanner import Window, misregister, simulate_scan, stand_at, stream_scan, window_around
from monitor.simulation.scenes import Body, Scene, TrueTarget, Truth, plane_scene, sphere_scene, step_scene, wave_scene

__all__ = [
    "INSTRUMENTS", "Body", "CarvedFigure", "DemoCampaign", "Instrument", "Scene", "TrueChange", "TrueTarget",
    "Truth", "Window", "carved_figure", "misregister", "plane_scene", "relief_scene", "simulate_scan",
    "sphere_scene", "stand_at", "step_scene", "stream_scan", "wave_scene", "window_around", "without_errors",
    "write_demo_campaign",
]  # fmt: skip
