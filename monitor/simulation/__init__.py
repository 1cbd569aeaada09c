"""A laboratory with known truth: instruments, scenes, a scanner that measures them, and the demo's campaign."""

from monitor.kernel_cache import prepare_cache
from monitor.simulation.attic_sculpture import attic_model, attic_scene
from monitor.simulation.campaign import Campaign, SurveyedEpoch, describe_truth, scan_stations, write_campaign
from monitor.simulation.changes import Edit, break_off, clean, coat, erode, fill, hollow_out, move_part, move_whole
from monitor.simulation.demo_campaign import DemoCampaign, write_demo_campaign
from monitor.simulation.figure import CarvedFigure, carved_figure
from monitor.simulation.instruments import INSTRUMENTS, Instrument, without_errors
from monitor.simulation.model import Model, ModelPart, box_part, build_scene, change_model
from monitor.simulation.planning import Visibility, plan_campaign, spread_points, visible_change
from monitor.simulation.reef import reef_model, reef_scene
from monitor.simulation.relief import relief_model, relief_scene
from monitor.simulation.repeated import Drift, drift_of_paper_003, repeat_scan
from monitor.simulation.room import room_model, room_scene
from monitor.simulation.scanner import Window, misregister, simulate_scan, stand_at, stream_scan, window_around
from monitor.simulation.scenes import Body, Scene, TrueTarget, Truth, plane_scene, sphere_scene, step_scene, wave_scene
from monitor.simulation.staircase import settlement, staircase_model, staircase_scene
from monitor.simulation.stations import Station, attic_stations, register_with_errors, stand_around, stove_stations
from monitor.simulation.stove import rebuild_stove, stove_model, stove_scene
from monitor.simulation.triangulation import TriangulationSensor, scan_by_triangulation
from monitor.simulation.true_change import TrueChange, change_at, measure_changes

prepare_cache()

__all__ = [
    "INSTRUMENTS", "Body", "Campaign", "CarvedFigure", "DemoCampaign", "Drift", "Edit", "Instrument", "Model",
    "ModelPart", "Scene", "Station", "SurveyedEpoch", "TriangulationSensor", "TrueChange", "TrueTarget", "Truth",
    "Visibility", "Window", "attic_model", "attic_scene", "attic_stations", "box_part", "break_off", "build_scene",
    "carved_figure", "change_at", "change_model", "clean", "coat", "describe_truth", "drift_of_paper_003", "erode",
    "fill", "hollow_out", "measure_changes", "misregister", "move_part", "move_whole", "plan_campaign",
    "plane_scene", "rebuild_stove", "reef_model", "reef_scene", "register_with_errors", "relief_model",
    "relief_scene", "repeat_scan", "room_model", "room_scene", "scan_by_triangulation", "scan_stations",
    "settlement", "simulate_scan", "sphere_scene", "spread_points", "staircase_model", "staircase_scene",
    "stand_around", "stand_at", "step_scene", "stove_model", "stove_scene", "stove_stations", "stream_scan",
    "visible_change", "wave_scene", "window_around", "without_errors", "write_campaign", "write_demo_campaign",
]  # fmt: skip
