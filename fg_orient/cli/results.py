"""Commands ``report``, ``replay``, ``accuracy`` and ``dsm-points``, which use the result folder of an adjustment."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from fg_orient.cli.command import Overwrite, argument, command, open_dem, option
from fg_orient.cli.output import answer, end_if, is_doubtful, number, say, table, tell, tell_findings, verdict
from fg_orient.cli.progress import progress, progress_bar
from fg_orient.model.errors import InputError

if TYPE_CHECKING:
    from fg_orient.orientation.replay import Replay

#: Maximum number of differences that are printed; ``--json`` contains all.
SHOWN: Final = 20

Folder = Annotated[Path, argument("DIR", "Result folder of adjust.")]


@command()
def report(
    folder: Annotated[Path, argument("DIR", "Folder of adjust or closerange.")],
    truth: Annotated[
        Path | None, option("Folder truth of a simulation; the result is compared with it.", "TRUTHDIR")
    ] = None,
    figures: Annotated[
        bool, option("Also write every plot as SVG and PDF to the folder DIR/figures.", flag="--figures")
    ] = False,
    figures_out: Annotated[Path | None, option("Write the plots to this folder instead.", "FOLDER")] = None,
    export: Annotated[
        Path | None, option("Write points, error vectors and footprints to a .gpkg or .geojson file.", "FILE")
    ] = None,
    vector_scale: Annotated[float | None, option("Enlarge the error vectors of --export N times.", "N")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Write report.html of a result folder again; with --truth, compare with the simulated truth."""
    from fg_orient.closerange.report import is_closerange
    from fg_orient.closerange.report import write_report as write_closerange

    closerange = is_closerange(folder)
    if closerange and (truth or export):
        raise InputError.of("closerange.no_layers", file=folder, option="truth, export", value=truth or export)
    with progress_bar("writing the report"):
        if closerange:
            path, comparison = write_closerange(folder), None
        else:
            from fg_orient.report import write_report

            path, comparison = write_report(folder, truth)
    record: dict[str, Any] = {"report": str(path), "truth": comparison}
    if figures or figures_out is not None:
        drawing = import_module("fg_orient.closerange.report" if closerange else "fg_orient.report.figures")
        with progress_bar("drawing the figures") as callback:
            drawn, names = drawing.write_figures(folder, figures_out, overwrite=overwrite, progress=callback)
        record["figures"] = {"folder": str(drawn), "files": names}
    if export is not None:
        from fg_orient.report.geofiles import export as write_layers

        with progress_bar("writing the layers"):
            features = write_layers(folder, export, vector_scale=vector_scale, overwrite=overwrite)
        record["export"] = {"file": str(export), "features": features}
    answer(record, _show_report)


def _show_report(record: dict[str, Any]) -> None:
    """Print the comparison with the truth and the written files."""
    if record["truth"] is not None:
        rows = [
            (g["name"], g["n"], number(g["rms_normalised"]), number(g["max_normalised"]))
            for g in record["truth"]["groups"]
        ]
        table("estimated minus true, in predicted standard deviations", ("what", "n", "RMS", "largest"), rows)
    say(f"report: {record['report']}")
    if "export" in record:
        layers = ", ".join(f"{n} {name.replace('_', ' ')}" for name, n in record["export"]["features"].items())
        say(f"layers: {record['export']['file']} ({layers})")
    if "figures" in record:
        say(f"figures: {record['figures']['folder']} ({len(record['figures']['files'])} files)")


@command()
def replay(
    folder: Folder,
    out: Annotated[Path | None, option("Result folder of the repeated run; default: DIR-replay, beside DIR.")] = None,
    project: Annotated[
        Path | None, option("Project file, if it is not in the folder above DIR.", "PROJECT.toml")
    ] = None,
    allow_changed: Annotated[
        bool, option("Continue if inputs have changed, and list them.", flag="--allow-changed")
    ] = False,
    overwrite: Overwrite = False,
) -> None:
    """Repeat a run from its record, with the same inputs and options, and compare every value of the result.

    The exit code is 0 if all values except times agree to the last bit, and 4 if any value differs.
    """
    from fg_orient.cli.adjust import load

    load()
    from fg_orient.orientation.replay import replay as repeat

    with progress() as watch:
        repeated = repeat(
            folder, out, project=project, allow_changed=allow_changed, overwrite=overwrite,
            callback=watch.iteration, stage=watch.stage,
        )  # fmt: skip
    answer(repeated.as_dict(), show_replay, repeated)
    end_if(not repeated.equal)


def show_replay(repeated: Replay) -> None:
    """Print changed inputs, different values and the folder of the repeated result."""
    for problem in (*repeated.inputs, *repeated.notes):
        tell("warning", f"{problem.file}: {problem.message}")
    for entry in repeated.versions:
        say(f"{entry['name']}: {entry['then'] or 'missing'} then, {entry['now'] or 'missing'} now")
    if repeated.differences:
        rows = [
            (d["key"], *("-" if v is None else str(v) for v in (d["then"], d["now"])))
            for d in repeated.differences[:SHOWN]
        ]
        table(f"values that differ: {len(repeated.differences)} of {repeated.n_compared}", ("key", "then", "now"), rows)
        if len(repeated.differences) > SHOWN:
            say(f"the first {SHOWN}; --json gives all")
    for name, same in repeated.tables.items():
        if not same:
            say(f"{name} differs")
    words = f"{repeated.n_compared} values and {len(repeated.tables)} tables are the same, bit by bit"
    verdict(words if repeated.equal else "the repeated run differs", good=repeated.equal)
    if repeated.out is not None:
        say(f"written: {repeated.out}")


@command()
def accuracy(
    folder: Folder,
    dem: Annotated[Path, option("Reference DEM of ellipsoidal heights, a raster that GDAL reads.", show_default=False)],
    role: Annotated[str | None, option("Use only points of this role: control, check or tie.")] = None,
) -> None:
    """Compare the heights of adjusted points with a DEM: bias, scatter, and the shift that explains them."""
    from fg_orient.quality.dem_accuracy import compare_dem, rows_of_role
    from fg_orient.result.record import read_result

    surface = open_dem(dem)
    points = read_result(folder).points
    chosen = rows_of_role(points.words["role"], role)
    with progress_bar("comparing"):
        record = compare_dem(points.numbers("x_m", "y_m", "z_m")[chosen], surface).as_dict()
    answer(record, _show_accuracy)


def _show_accuracy(record: dict[str, Any]) -> None:
    """Print the differences between the heights, and the estimated shift."""
    rows = [(key, str(value) if isinstance(value, int) else number(value)) for key, value in record.items()
            if isinstance(value, (int, float))]  # fmt: skip
    table("adjusted minus reference height", ("figure", "value"), rows)
    shift = record["shift"]
    if shift is not None:
        shifts = [
            (a, number(shift[f"{a}_m"]), number(shift[f"sigma_{a}_m"]), "yes" if a in shift["significant"] else "no")
            for a in ("east", "north", "up")
        ]
        table("shift of the points against the reference, m", ("axis", "shift", "sigma", "significant"), shifts)
        before, after = number(shift["rmse_before_m"]), number(shift["rmse_after_m"])
        say(f"RMSE of {shift['n']} points: {before} m, without the shift {after} m")
    tell_findings(record)


@command()
def dsm_points(
    folder: Folder,
    out: Annotated[Path, option("File to write: .laz, .las, .ply, .csv or .gpkg.", "FILE", show_default=False)],
    crs: Annotated[
        str, option("CRS in place of the project's, such as EPSG:32636 or EPSG:32636+EGM96.", "EPSG:N[+M|+NAME]")
    ] = "",
    geoid: Annotated[Path | None, option("Geoid file of the heights, in place of the project's.", "FILE")] = None,
    max_sigma_height: Annotated[
        float | None, option("Largest standard deviation of the height, m.", "M", min=0.0)
    ] = None,
    min_rays: Annotated[int, option("Smallest number of image points.", "N", min=1)] = 2,
    control: Annotated[bool, option("Write control points, too.", flag="--control")] = False,
    rejected: Annotated[
        bool,
        option("Also write points for which the search for gross errors left out an observation.", flag="--rejected"),
    ] = False,
    overwrite: Overwrite = False,
) -> None:
    """Write the adjusted points as a point cloud with covariances, to check the orientation. It is no surface model."""
    from fg_orient.report.adjusted_points import Selection, export_points

    selection = Selection(control, rejected, min_rays, max_sigma_height)
    with progress_bar("writing the points"):
        record = export_points(folder, out, crs=crs, geoid=geoid, selection=selection, overwrite=overwrite)
    answer(record, _show_points)
    end_if(is_doubtful(record))


def _show_points(record: dict[str, Any]) -> None:
    """Print the written file, the numbers of written and omitted points, and the findings."""
    from fg_orient.report.adjusted_points import describe, in_words

    say(f"{record['points']} {describe(record)}")
    tell_findings(record)
    if any(record["left_out"].values()):
        say(f"left out: {in_words(record['left_out'])}")
    say(f"written: {record['file']}")
