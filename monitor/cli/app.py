"""The table of commands: names, arguments and options as other programs rely on them.

Each command imports what it needs when it runs, so that help and errors come at once.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(
    name="monitor",
    help="Follow the state of monuments through time: laser scans in, difference models and reports out.",
    epilog=(
        "The usual way: init, add-object, add-epoch once a survey, process, compare, report. Every command has --help; "
        "--debug shows the traceback of an error."
    ),
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

ProjectArgument = Annotated[Path, typer.Argument(metavar="PROJECT", help="Folder of the project.")]
ObjectArgument = Annotated[str, typer.Argument(metavar="OBJECT", help="Id of the object: letters, digits, . and -")]
OptionalObject = Annotated[str | None, typer.Argument(metavar="OBJECT", help="Id of the object; all by default.")]
EpochArgument = Annotated[str, typer.Argument(metavar="EPOCH", help="Id of the epoch: letters, digits, . and -")]
Reference = Annotated[str | None, typer.Argument(metavar="REFERENCE", help="Id of the earlier epoch.")]
Compared = Annotated[str | None, typer.Argument(metavar="COMPARED", help="Id of the later epoch.")]
OutOption = Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder to write to; made if missing.")]
NewFolder = Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder to write, new or empty.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON for a program.")]
SettingsOption = Annotated[
    Path | None,
    typer.Option(
        "--settings", metavar="FILE.toml", help="Settings that differ from the defaults; see: monitor settings."
    ),
]
WorkersOption = Annotated[
    int | None, typer.Option("--workers", metavar="N", help="Use N local worker processes; 1 is this one.")
]
SchedulerOption = Annotated[
    str | None, typer.Option("--scheduler", metavar="ADDRESS", help="Use the Dask cluster at this address.")
]
Text = Annotated[str, typer.Option()]


@app.command()
def demo(out: OutOption = Path("monitor-demo")) -> None:
    """Run the whole job on a bundled example and name the report."""
    from monitor.cli.demo import run_demo

    run_demo(out)


@app.command()
def init(
    project: ProjectArgument,
    name: Annotated[str, typer.Option(help="Name of the project, free text.")] = "",
    crs: Annotated[
        str, typer.Option(metavar="EPSG:n", help="Reference system of the project's coordinates: plane, in metres.")
    ] = "",
    description: Annotated[str, typer.Option(help="What the project is about, free text.")] = "",
) -> None:
    """Start a project in a new or empty folder."""
    from monitor.cli.keeping import init_project

    init_project(project, name, crs, description)


@app.command("add-object")
def add_object(
    project: ProjectArgument,
    object_id: ObjectArgument,
    name: Annotated[str, typer.Option(help="Name, free text.")] = "",
    inventory: Annotated[str, typer.Option(help="Inventory number.")] = "",
    place: Annotated[str, typer.Option(help="Where it stands.")] = "",
    material: Annotated[str, typer.Option(help="What it is made of.")] = "",
    description: Annotated[str, typer.Option(help="Free text.")] = "",
    extent: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="JSON file with the box or polygon, in metres, that holds the object; points outside are left out: "
            '{"box": {"min": [x, y, z], "max": [x, y, z]}} or {"polygon": [[x, y], ...], "bottom": z, "top": z}.',
        ),
    ] = None,
    tolerance: Annotated[
        float | None,
        typer.Option(metavar="MM", help="The client's tolerance in millimetres, reported beside the detection."),
    ] = None,
    front: Annotated[
        str | None,
        typer.Option(
            metavar="DIRECTION",
            help="Side to which its front faces: north (+y), east (+x), south, west, or degrees clockwise from north; "
            "of a room, to which the wall ahead faces: south for the northern wall. Found from the surface where not "
            "given.",
        ),
    ] = None,
) -> None:
    """Add an object: a sculpture, a stove, a staircase, a room."""
    from monitor.cli.keeping import add_object_to_project

    texts = {"name": name, "inventory": inventory, "place": place, "material": material, "description": description}
    add_object_to_project(project, object_id, texts, extent, tolerance, front)


@app.command("set-front")
def set_front(
    project: ProjectArgument,
    object_id: ObjectArgument,
    direction: Annotated[
        str,
        typer.Argument(
            metavar="DIRECTION", help="north (+y), east (+x), south, west, or degrees clockwise from north, 0 to 360."
        ),
    ],
) -> None:
    """Say to which side the front of an object faces, where a report guessed wrong; nothing is computed anew."""
    from monitor.cli.keeping import set_front_of_object

    set_front_of_object(project, object_id, direction)


@app.command("add-epoch")
def add_epoch(
    project: ProjectArgument,
    object_id: ObjectArgument,
    epoch_id: EpochArgument,
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE...",
            help="Scans of one survey: E57, PTX, PTS, LAS, LAZ, PLY, PCD, OBJ, STL, GLB, XYZ, TXT, CSV.",
        ),
    ],
    date: Annotated[str, typer.Option(metavar="YYYY-MM-DD", help="Date of the survey.")],
    label: Annotated[str, typer.Option(help="Name of the epoch, free text: before restoration.")] = "",
    scanner: Annotated[
        str | None,
        typer.Option(
            metavar="PRESET", help="Instrument, a wrong name lists those known; without it, found from the scans."
        ),
    ] = None,
    operator: Annotated[str, typer.Option(help="Who made the survey, free text.")] = "",
    poses: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="One line a scan: file name and 16 numbers T_project_scanner, row by row."),
    ] = None,
    control: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.csv", help="Control points: name,x,y,z[,sigma], or as its first line names the columns."
        ),
    ] = None,
    repeated: Annotated[
        bool, typer.Option("--repeated", help="The files are repeated scans from one station.")
    ] = False,
    mesh: Annotated[bool, typer.Option("--mesh", help="The file is a finished surface: PLY, OBJ, STL, GLB.")] = False,
    unit: Annotated[
        str | None,
        typer.Option(metavar="m|mm|cm|in|ft", help="Unit of files, poses and control; metres where not given."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Add the object's state at one date, from its scans."""
    from monitor.cli.adding import EpochRequest, add_epoch_to_project

    request = EpochRequest(
        object_id=object_id, epoch_id=epoch_id, date=date, label=label, scanner=scanner, operator=operator,
        poses=poses, control=control, repeated=repeated, mesh=mesh, unit=unit, files=tuple(files),
    )  # fmt: skip
    add_epoch_to_project(project, request, as_json)


@app.command("remove-epoch")
def remove_epoch(
    project: ProjectArgument,
    object_id: ObjectArgument,
    epoch_id: EpochArgument,
    purge: Annotated[bool, typer.Option("--purge", help="Also delete its files; this cannot be undone.")] = False,
) -> None:
    """Take an epoch out; its files stay on disk until --purge."""
    from monitor.cli.keeping import remove_epoch_from_project

    remove_epoch_from_project(project, object_id, epoch_id, purge)


@app.command()
def process(
    project: ProjectArgument,
    object_id: OptionalObject = None,
    epoch_id: Annotated[str | None, typer.Argument(metavar="EPOCH", help="Id of the epoch; all by default.")] = None,
    settings: SettingsOption = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Make surfaces of scans; does only what is missing."""
    from monitor.cli.working import process_project

    process_project(project, object_id, epoch_id, settings_file=settings, where=(workers, scheduler), as_json=as_json)


@app.command()
def compare(
    project: ProjectArgument,
    object_id: ObjectArgument,
    reference: Reference = None,
    compared: Compared = None,
    mode: Annotated[
        str | None,
        typer.Option(
            metavar="relative|absolute",
            help="Remove the motion of the whole, or keep it; absolute where both have control.",
        ),
    ] = None,
    stable: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Where nothing moved or changed: a box or a polygon as of --extent, in the reference's coordinates. "
            "It alone tells the level of detection, and all the rest may have changed; found where left out.",
        ),
    ] = None,
    settings: SettingsOption = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    as_json: JsonOption = False,
) -> None:
    """Compare epochs; by default with the first and the previous.

    What the later epoch has more of is gained, what it has less of is lost. Where nothing can be said is told too.
    """
    from monitor.cli.working import compare_object

    compare_object(
        project, object_id, (reference, compared), mode=mode, stable_file=stable, settings_file=settings,
        where=(workers, scheduler), as_json=as_json,
    )  # fmt: skip


@app.command()
def export(
    project: ProjectArgument,
    object_id: ObjectArgument,
    out: OutOption,
    reference: Annotated[
        str | None, typer.Argument(metavar="REFERENCE|EPOCH", help="Earlier epoch, or the one to export.")
    ] = None,
    compared: Compared = None,
    formats: Annotated[
        str,
        typer.Option(
            "--format",
            metavar="LIST",
            help="Of ply,glb,obj,stl,laz,e57,csv,screen; with commas. screen: a light GLB of one epoch, to look at.",
        ),
    ] = "ply",
) -> None:
    """Write surfaces and difference models as files.

    One epoch, or the comparison of two; all that there is where none is named. Metres; a comparison is in the reference
    epoch's coordinates, and what was gained is positive. A table of regions and a summary go with it.
    """
    from monitor.cli.results import export_results

    export_results(project, object_id, (reference, compared), out, formats)


@app.command()
def report(
    project: ProjectArgument,
    object_id: ObjectArgument,
    out: OutOption,
    reference: Reference = None,
    compared: Compared = None,
) -> None:
    """Write what changed, where and how sure: an HTML page and a PDF to be signed and filed.

    Of the comparison of two epochs; of every one that was made where none is named.
    """
    from monitor.cli.results import write_reports

    write_reports(project, object_id, (reference, compared), out)


@app.command()
def archive(project: ProjectArgument, out: NewFolder, object_id: OptionalObject = None) -> None:
    """Write a documentation archive that needs no program of ours: BagIt and RO-Crate.

    Scans as measured, registration, clouds, meshes, difference models, reports, and how each came to be; of one object,
    or of all.
    """
    from monitor.cli.archiving import archive_project

    archive_project(project, object_id, out)


@app.command()
def verify(
    path: Annotated[Path, typer.Argument(metavar="PATH", help="Folder of a project, or an archive.")],
    as_json: JsonOption = False,
) -> None:
    """Check every file of a project or of an archive against its record."""
    from monitor.cli.keeping import verify_folder

    verify_folder(path, as_json)


@app.command()
def status(project: ProjectArgument, as_json: JsonOption = False) -> None:
    """Show objects, epochs and what has been done."""
    from monitor.cli.keeping import show_status

    show_status(project, as_json)


@app.command("run")
def run_command(
    campaign: Annotated[Path, typer.Argument(metavar="CAMPAIGN.toml", help="File that declares the campaign.")],
    settings: SettingsOption = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
) -> None:
    """Run a whole campaign, many objects, declared in one file.

    Adds what the project lacks, processes, compares, and writes reports, exports and an archive where the file wants
    them. Run again, it goes on, or adds what the file has gained.
    """
    from monitor.cli.campaign import run_campaign

    run_campaign(campaign, settings, (workers, scheduler))


@app.command()
def serve(
    project: ProjectArgument,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Of the page's address; a free one by default.")] = 0,
) -> None:
    """Browse a project in a page on this machine: objects, epochs, differences, reports."""
    from monitor.cli.serving import serve_project

    serve_project(project, port)


@app.command()
def plan(
    mesh: Annotated[
        Path, typer.Argument(metavar="MESH", help="PLY, OBJ, STL or GLB: an exported epoch, a drawing, a photo model.")
    ],
    out: OutOption,
    change: Annotated[float, typer.Option(metavar="MM", help="Change that is to be seen.")] = 2.0,
    width: Annotated[float, typer.Option(metavar="MM", help="How wide it is; three pulses must fall on it.")] = 20.0,
    scanner: Annotated[str, typer.Option(metavar="PRESET", help="Instrument.")] = "phase-2020",
    distances: Annotated[
        str, typer.Option(metavar="M,...", help="From the circle about the object to where one may stand.")
    ] = "3.5",
    heights: Annotated[str, typer.Option(metavar="M,...", help="Of the scanner above the object's foot.")] = "1.5,2.9",
    every: Annotated[float, typer.Option(metavar="DEG", help="Between places around the object.")] = 45.0,
    registration: Annotated[
        float, typer.Option(metavar="MM", help="To what the stations will be registered, one sigma.")
    ] = 0.3,
    reflectance: Annotated[float, typer.Option(help="Of the surface, 0 to 1.")] = 0.6,
    beside: Annotated[
        list[Path] | None, typer.Option(metavar="FILE", help="Mesh of what else stands there; may be repeated.")
    ] = None,
    unit: Annotated[
        str | None, typer.Option(metavar="m|mm|cm|in|ft", help="Unit of the files; metres where not given.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Plan a campaign: from where is a change seen?

    Stations around a model of the object are tried, each with several resolutions.
    """
    from monitor.cli.planning import PlanRequest, plan_for_mesh

    request = PlanRequest(
        mesh=mesh, out=out, scanner=scanner, change=change, width=width, registration=registration,
        distances=distances, heights=heights, every=every, reflectance=reflectance, beside=tuple(beside or ()),
        unit=unit,
    )  # fmt: skip
    plan_for_mesh(request, as_json)


@app.command()
def settings() -> None:
    """Print every setting with unit, default and meaning, as TOML."""
    from monitor.settings import to_toml

    typer.echo(to_toml(), nl=False)
