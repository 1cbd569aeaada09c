"""Scanner formats: scans and meshes stream in, results are written out.

The names are loaded when first asked for, so that the child process that parses a file starts in a tenth of a second.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from projects.formats.control import read_control as read_control
    from projects.formats.e57_writer import write_e57 as write_e57
    from projects.formats.glb_writer import write_glb as write_glb
    from projects.formats.glb_writer import write_screen_glb as write_screen_glb
    from projects.formats.las_writer import write_las as write_las
    from projects.formats.mesh_writers import require_stl_holds as require_stl_holds
    from projects.formats.mesh_writers import surface_properties as surface_properties
    from projects.formats.mesh_writers import write_obj as write_obj
    from projects.formats.mesh_writers import write_ply_mesh as write_ply_mesh
    from projects.formats.mesh_writers import write_stl as write_stl
    from projects.formats.meshes import read_counted_mesh as read_counted_mesh
    from projects.formats.meshes import read_mesh as read_mesh
    from projects.formats.parsing import ReadLimits as ReadLimits
    from projects.formats.poses import PoseLine as PoseLine
    from projects.formats.poses import doubt_places as doubt_places
    from projects.formats.poses import find_pose_line as find_pose_line
    from projects.formats.poses import read_poses as read_poses
    from projects.formats.poses import require_known_names as require_known_names
    from projects.formats.ptx_writer import write_ptx as write_ptx
    from projects.formats.scans import ScanStream as ScanStream
    from projects.formats.scans import read_scans as read_scans
    from projects.formats.sniffing import sniff_format as sniff_format
    from projects.formats.table_writer import write_csv as write_csv
    from projects.formats.units import metres_per_unit as metres_per_unit
    from projects.formats.units import question_system as question_system
    from projects.formats.units import question_unit as question_unit

_HOME = {
    "PoseLine": "poses",
    "ReadLimits": "parsing",
    "ScanStream": "scans",
    "doubt_places": "poses",
    "find_pose_line": "poses",
    "metres_per_unit": "units",
    "question_system": "units",
    "question_unit": "units",
    "read_control": "control",
    "read_counted_mesh": "meshes",
    "read_mesh": "meshes",
    "read_poses": "poses",
    "read_scans": "scans",
    "require_known_names": "poses",
    "sniff_format": "sniffing",
    "surface_properties": "mesh_writers",
    "write_csv": "table_writer",
    "write_e57": "e57_writer",
    "require_stl_holds": "mesh_writers",
    "write_glb": "glb_writer",
    "write_las": "las_writer",
    "write_obj": "mesh_writers",
    "write_ply_mesh": "mesh_writers",
    "write_ptx": "ptx_writer",
    "write_screen_glb": "glb_writer",
    "write_stl": "mesh_writers",
}

__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    """Load a public name from its module (PEP 562)."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
