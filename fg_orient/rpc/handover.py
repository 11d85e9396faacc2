"""Export RPC to other programs: write the files that a program reads, and describe how it reads them.

An ``.adjust`` file of ASP moves a camera by a translation t in ECEF: a ground point X is
projected to the pixel to which the vendor's model projects X - t. A compensation in the
image is only approximately equal to such a movement. The file is written if movement and compensation
agree within ``SAME_PX`` everywhere in the image. Otherwise the reason is reported.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from factors.arrays import Array
from factors.cameras.rfm_project import COMPENSATION, RANGE
from fg_orient.formats.atomic import made_folder, outputs, require_free_files, write_text
from fg_orient.formats.registry import formats
from fg_orient.formats.rpc import read_rpc
from fg_orient.formats.table_write import table_file
from fg_orient.geodesy import ecef_to_geodetic, geodetic_to_ecef
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.model.names import Status
from fg_orient.model.options import Options
from fg_orient.result.plain import read_table
from fg_orient.result.record import RESULT_FILE, doubts_about, read_record
from fg_orient.result.summary import file_stems
from fg_orient.rpc.files import IMAGES, write_alone
from fg_orient.rpc.virtual_grid import with_image_to_ground
from fg_orient.sensors.rpc import RpcModel
from fg_orient.sensors.rpc_sensor import RpcSensor

#: Largest difference between a movement of the camera and a compensation, px.
SAME_PX: Final = 0.01
#: Both are compared at this number of lines, samples and heights.
NODES: Final = (9, 9, 5)


@dataclass(frozen=True)
class Program:
    """Input of a program: a format, the suffix of its file name, and its use."""

    format: str
    end: str
    use: str


#: Programs by name; ``{stem}`` stands for the image's name without its suffix.
PROGRAMS: Final = {
    "gdal": Program(
        "rpc-txt", "_RPC.TXT",
        "put {stem}_RPC.TXT beside {stem}.tif (or open {stem}.vrt, if it is written): gdalwarp -rpc "
        "-to RPC_DEM=dem.tif {stem}.tif ortho.tif",
    ),
    "qgis": Program(
        "rpc-txt", "_RPC.TXT",
        "put {stem}_RPC.TXT beside {stem}.tif (or open {stem}.vrt, if it is written): Raster, Projections, Warp, "
        "with the additional parameters -rpc -to RPC_DEM=dem.tif",
    ),
    "otb": Program(
        "ossim-geom", ".geom",
        'put {stem}.geom beside {stem}.tif, or name it: otbcli_OrthoRectification -io.in '
        '"{stem}.tif?&geom={stem}.geom" -io.out ortho.tif -elev.dem DEMS',
    ),
    "asp": Program(
        "rpb", ".RPB",
        "put {stem}.RPB beside {stem}.tif: parallel_stereo -t rpc LEFT.tif RIGHT.tif run/run",
    ),
    "cars": Program(
        "ossim-geom", ".geom",
        'in inputs.sensors of the configuration: {{"image": "{stem}.tif", "geomodel": {{"path": "{stem}.geom", '
        '"model_type": "RPC"}}}}',
    ),
    "s2p": Program(
        "rpc-txt", "_RPC.TXT", 'in images of config.json: {{"img": "{stem}.tif", "rpc": "{stem}_RPC.TXT"}}'
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Handed:
    """Model of an image, the compensation (6,), px, that it contains (None if unknown), and the name of its files."""

    model: RpcModel
    values: Array | None
    stem: str


def model_of(file: Path, model: RpcModel) -> dict[str, Handed]:
    """Return the model of a file with the name of its image, which is the file name without ``RPC``."""
    stem = re.sub(r"(?i)_RPC$|^RPC_", "", file.stem) or file.stem
    return {stem: Handed(model, None, stem)}


def models_of(result: Path) -> tuple[dict[str, Handed], tuple[Finding, ...]]:
    """Return the corrected models of the RPC images of a result folder by image id, and findings on them.

    Raises
    ------
    InputError
        The folder is no result of ``adjust``, nothing was adjusted, or no image has an RPC.
    """
    record = read_record(result)
    if record.get("status") == Status.RANK_DEFICIENT:
        raise InputError.of("report.nothing_adjusted", file=result, place=RESULT_FILE, value=record["status"])
    try:
        images = {str(entry["id"]): entry for entry in record["images"]}
        with_rpc = [name for name, entry in images.items() if entry["model"] == "RPC"]
        table = read_table(table_file(result, "eop"))
        columns = (table.words["image"], table.words["parameter"], table.figures["value_per_tau"].tolist())
        values: dict[str, dict[str, float]] = {name: {} for name in images}
        for name, parameter, value in zip(*columns, strict=True):
            values[name][parameter] = value
        sizes = {name: (int(images[name]["n_lines"]), int(images[name]["n_samples"])) for name in with_rpc}
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError.of("report.damaged", file=result, value=error) from None
    if not with_rpc:
        raise InputError.of("handover.no_rpc", file=result)
    out = {}
    for name, stem in file_stems(with_rpc).items():
        model = read_rpc(result / "rpc" / f"{stem}_RPC.TXT")
        model = replace(model, n_lines=sizes[name][0], n_samples=sizes[name][1])
        out[name] = Handed(model, RpcSensor(model, poles=True).correction_of(values[name], Options()), stem)
    notes = [finding("handover.rigorous", place=f"image {name}") for name in images if name not in with_rpc]
    return out, (*doubts_about(record, result), *notes)


def hand_over(
    models: Mapping[str, Handed],
    out: Path,
    program: str = "",
    *,
    target: str = "",
    images: Mapping[str, Path] | None = None,
    overwrite: bool = False,
) -> tuple[list[dict[str, Any]], tuple[Finding, ...]]:
    """Write the files that a program reads, or files of one format, into a folder.

    Parameters
    ----------
    models : mapping of str to Handed
        By image id.
    out : Path
        Folder; it is made if it does not exist.
    program : str
        One of ``PROGRAMS``.
    target : str
        Name of a format, as an alternative to ``program``.
    images : mapping of str to Path, optional
        Raster files by image id: the files are named after them. ``gdal`` and ``qgis``
        also get a virtual raster; ``geotiff-tags`` and ``vrt`` need them.
    overwrite : bool

    Returns
    -------
    list of dict
        Records as :func:`fg_orient.rpc.files.write_as` gives them, with ``image`` and ``use``.
    tuple of Finding
        Remarks.

    Raises
    ------
    InputError
        An unknown program or image, a file exists or cannot be written.
    """
    images = images or {}
    for name in images:
        if name not in models:
            raise InputError.of("handover.no_image", option="image", value=name, known=", ".join(models))
    if program and program not in PROGRAMS:
        raise InputError.of("handover.program", option="for", value=program, known=", ".join(PROGRAMS))
    kind = PROGRAMS[program] if program else Program(target, _end_of(target), "")
    missing = [name for name in models if kind.format in IMAGES and name not in images]
    if missing:
        raise InputError.of("handover.needs_image", option="image", value=missing[0], format=kind.format)
    jobs: list[tuple[str, Path, str]] = []
    stems = {name: images[name].stem if name in images else handed.stem for name, handed in models.items()}
    if len(set(stems.values())) < len(stems):
        raise InputError.of("handover.names", option="image", value=", ".join(stems.values()))
    for name, stem in stems.items():
        jobs.append((name, out / f"{stem}{kind.end}", kind.format))
        if name in images and program in ("gdal", "qgis"):
            jobs.append((name, out / f"{stem}.vrt", "vrt"))
    known = {name: handed for name, handed in models.items() if handed.values is not None and program == "asp"}
    moved = {name: translation(handed) for name, handed in known.items()}
    paths = {name: out / f"adjust-{stems[name]}.adjust" for name, move in moved.items() if move.is_same}
    files = [*(path for _, path, _ in jobs), *paths.values()]
    require_free_files(*files, overwrite=overwrite)
    # readers of DIMAP need the models of both directions
    whole = {
        name: with_image_to_ground(handed.model)
        if kind.format == "dimap" and handed.model.direct is None
        else handed.model
        for name, handed in models.items()
    }
    with made_folder(out), outputs(*files, overwrite=overwrite):
        written = [
            {
                "image": name,
                **write_alone(whole[name], path, form, image=images.get(name)),
                "use": kind.use.format(stem=stems[name]),
            }
            for name, path, form in jobs
        ]
        for name, path in paths.items():
            write_text(path, moved[name].text)
    notes = []
    for name, move in moved.items():
        if name in paths:
            notes.append(finding("handover.adjust", file=paths[name], place=f"image {name}", most_px=move.most_px))
        else:
            notes.append(finding("handover.no_translation", place=f"image {name}", most_px=move.most_px, limit=SAME_PX))
    return written, tuple(notes)


def _end_of(target: str) -> str:
    """Return the suffix of a file of a format."""
    return {"rpc-txt": "_RPC.TXT", "rpb": ".RPB", **IMAGES}.get(target) or formats("rpc")[target].suffixes[0]


# --- ASP ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Translation:
    """Movement of a camera (3,) ECEF m, and the largest difference in pixels from the compensated model."""

    ecef_m: Array
    most_px: float

    @property
    def is_same(self) -> bool:
        """True if the movement replaces the compensation."""
        return self.most_px <= SAME_PX

    @property
    def text(self) -> str:
        """Contents of an ``.adjust`` file: the translation, and the quaternion of no rotation."""
        return " ".join(repr(float(v)) for v in self.ecef_m) + "\n1 0 0 0\n"


def translation(handed: Handed) -> Translation:
    """Fit the movement of the vendor's camera that agrees best with a compensation over image and heights."""
    model = handed.model
    axes = [
        np.linspace(low, high, n)
        for (low, high), n in zip(
            (model.validity.line, model.validity.sample, model.validity.height_m), NODES, strict=True
        )
    ]
    line, sample, height = (a.ravel() for a in np.meshgrid(*axes))
    lon, lat = model.locate(line, sample, height)
    seen = np.isfinite(lon)
    ground, wanted = geodetic_to_ecef(lon[seen], lat[seen], height[seen]), np.stack([line[seen], sample[seen]], axis=1)

    def misfit(move: Array) -> Array:
        return np.asarray((vendor_pixels(handed, *ecef_to_geodetic(ground - move)) - wanted).ravel())

    move, steps = np.zeros(3), np.eye(3)  # steps of 1 m, which is about one pixel
    for _ in range(3):
        jacobian = np.stack([0.5 * (misfit(move + step) - misfit(move - step)) for step in steps], axis=1)
        move = move - np.linalg.lstsq(jacobian, misfit(move), rcond=None)[0]
    return Translation(move, float(np.abs(misfit(move)).max()))


def vendor_pixels(handed: Handed, lon_deg: Array, lat_deg: Array, height_m: Array) -> Array:
    """Return line and sample (N, 2) of the model without its compensation, by inversion of the compensation."""
    model, c = handed.model, np.zeros(6) if handed.values is None else handed.values
    scale = model.scales[RANGE.image]
    offset = model.offsets[RANGE.image] - c[[COMPENSATION.line, COMPENSATION.sample]]
    matrix = np.array([[scale[0] + c[COMPENSATION.line_l], c[COMPENSATION.line_s]],
                       [c[COMPENSATION.sample_l], scale[1] + c[COMPENSATION.sample_s]]])  # fmt: skip
    pixels = np.stack(model.project(lon_deg, lat_deg, height_m)) - model.offsets[RANGE.image, None]
    return np.asarray((offset[:, None] + scale[:, None] * np.linalg.solve(matrix, pixels)).T)
