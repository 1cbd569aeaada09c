"""A laboratory with known truth: instruments, scenes, a scanner that measures them, and the demo's campaign."""

from monitor.simulation.campaign import DemoCampaign, write_demo_campaign
from monitor.simulation.changes import (
    Edit,
    break_off,
    clean,
    coat,
    erode,
    fill,
    hollow_out,
    move_part,
    move_whole,
)
from monitor.simulation.figure import CarvedFigure, carved_figure
from monitor.simulation.instruments import INSTRUMENTS, Instrument, without_errors
from monitor.simulation.model import Model, ModelPart, box_part, build_scene, change_model
from monitor.simulation.relief import relief_scene
from monitor.simulation.repeated import Drift, drift_of_paper_003, repeat_scan
from monitor.simulation.scanner import Window, misregister, simulate_scan, stand_at, stream_scan, window_around
from monitor.simulation.scenes import Body, Scene, TrueTarget, Truth, plane_scene, sphere_scene, step_scene, wave_scene
from monitor.simulation.triangulation import TriangulationSensor, scan_by_triangulation
from monitor.simulation.true_change import TrueChange, change_at, measure_changes

__all__ = [
    "INSTRUMENTS", "Body", "CarvedFigure", "DemoCampaign", "Drift", "Edit", "Instrument", "Model", "ModelPart",
    "Scene", "TriangulationSensor", "TrueChange", "TrueTarget", "Truth", "Window", "box_part", "break_off",
    "build_scene", "carved_figure", "change_at", "change_model", "clean", "coat", "drift_of_paper_003", "erode",
    "fill", "hollow_out", "measure_changes", "misregister", "move_part", "move_whole", "plane_scene",
    "relief_scene", "repeat_scan", "scan_by_triangulation", "simulate_scan", "sphere_scene", "stand_at",
    "step_scene", "stream_scan", "wave_scene", "window_around", "without_errors", "write_demo_campaign",
]  # fmt: skip
