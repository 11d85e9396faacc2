"""Writer of a simulated block in the real file formats, with its truth.

``<image>.DIM`` (DIMAP 1.1), ``points.csv``, ``observations.csv``, ``project.toml``; in
``truth/`` the error-free ``points.csv``, ``eop.csv`` (true minus metadata) and
``options.json``, which the adjustment never reads. The folder appears whole or not at all.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from fg_orient.formats.atomic import Contents, require_free, staged_folder, write_text, writing
from fg_orient.formats.dimap_write import write_dimap1
from fg_orient.formats.points_write import write_observations, write_points, write_project
from fg_orient.model.names import COMPONENTS
from fg_orient.model.parameters import UNITS, parameter_name

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    from fg_orient.model.block import Options
    from fg_orient.model.names import Progress
    from fg_orient.sensors.metadata import PushbroomMetadata
    from fg_orient.simulate.simulation import Simulation, Truth

    #: Writes further files of a simulation into its folder.
    More = Callable[[Path, Any], None]
    Rows = list[list[str]]

PROJECT_FILE = "project.toml"
#: Only a folder that a simulation wrote may be replaced: a real project has no ``truth/options.json``.
CONTENTS: Final = Contents(
    "truth/options.json",
    (PROJECT_FILE, "points.csv", "observations.csv", "*.DIM", "truth/points.csv", "truth/eop.csv",
     "truth/options.json", "*.tif", "*_RPC.TXT", "camera.toml", "frame*.toml"),
)  # fmt: skip


@dataclass(frozen=True)
class ImageWriter:
    """Files of the images of a kind of simulation.

    Parameters
    ----------
    images : callable
        Writes their metadata into a folder; gives ids and file names.
    orientation : callable
        Rows of ``truth/eop.csv``.
    options : Options or None
        Options of the project file; None: all at their defaults.
    """

    images: Callable[[Path, Any], list[tuple[str, str]]]
    orientation: Callable[[Truth], Rows]
    options: Options | None = None


def simulate_to(
    out: str | Path, draw: Callable[[], Simulation], options: DataclassInstance, command: str, *, overwrite: bool,
    more: More | None = None, writer: ImageWriter | None = None,
) -> Path:  # fmt: skip
    """Draw a block and write it; an unusable folder is refused before anything is drawn.

    Parameters
    ----------
    out : str or Path
        Folder to make.
    draw : callable
        Gives the simulation.
    options : dataclass
        Options of the simulator, for the headers and ``truth/options.json``.
    command : str
        Command that makes it, for the headers.
    overwrite : bool
        Replace a folder that an earlier simulation wrote (``truth/options.json``) and that holds
        nothing else.
    more : callable, optional
        Writes further files into the folder.
    writer : ImageWriter, optional
        Default: DIMAP 1.1 of a ``Simulation``.

    Returns
    -------
    Path
        The project file.

    Raises
    ------
    InputError
        The folder exists, or cannot be written; nothing is left behind.
    """
    target, form = Path(out), writer or DIMAP
    require_free(target, overwrite=overwrite, contents=CONTENTS)
    simulation, values = draw(), {"command": command, **asdict(options)}
    with staged_folder(target, overwrite=overwrite, contents=CONTENTS) as folder:
        _write_block(folder, simulation, values, form)
        with writing(target):
            (folder / "truth").mkdir()
        _write_truth(folder / "truth", simulation, values, form)
        if more is not None:
            more(folder, simulation)
    return target / PROJECT_FILE


def _write_block(folder: Path, simulation: Simulation, values: dict[str, Any], writer: ImageWriter) -> None:
    made = [f"simulated by fg_orient: {values['command']}", f"options: {json.dumps(values, sort_keys=True)}"]
    images = writer.images(folder, simulation)
    ground, truth = simulation.ground, simulation.truth
    known = ground.known[:, None]
    write_points(
        folder / "points.csv", ground.ids, ground.roles, np.where(known, ground.measured, np.nan),
        np.where(known, ground.sigma_enu_m, np.nan),
        comments=[*made, "measured values: WGS84, ellipsoidal heights; sigmas at the point", "crs: EPSG:4979"],
    )  # fmt: skip
    write_observations(
        folder / "observations.csv", [truth.image_ids[k] for k in simulation.image],
        [ground.ids[j] for j in simulation.point], simulation.observed, np.array(simulation.sigma_px),
        comments=[*made, "(0, 0) is the centre of the first pixel"],
    )  # fmt: skip
    write_project(
        folder / PROJECT_FILE, name=simulation.name, images=images, options=writer.options, comments=made
    )  # fmt: skip


def write_dimaps(
    folder: Path, name: str, images: Sequence[PushbroomMetadata], progress: Progress | None = None
) -> list[str]:
    """Write DIMAP 1.1 of images; give the file names."""
    for k, metadata in enumerate(images):
        if progress is not None:
            progress(k, len(images), "metadata files")
        write_dimap1(folder / metadata.file, metadata, dataset_name=f"{name}, simulated")
    return [metadata.file for metadata in images]


def images_of(folder: Path, simulation: Simulation, progress: Progress | None = None) -> list[tuple[str, str]]:
    """Write DIMAP 1.1 of the images of a simulation; give their ids and file names."""
    files = write_dimaps(folder, simulation.name, simulation.metadata, progress)
    return list(zip(simulation.truth.image_ids, files, strict=True))


def _write_truth(folder: Path, simulation: Simulation, values: dict[str, Any], writer: ImageWriter) -> None:
    truth = simulation.truth
    rows = [
        [name, str(role), *map(repr, lonlat.tolist()), *map(repr, xyz.tolist())]
        for name, role, lonlat, xyz in zip(
            truth.point_ids, simulation.ground.roles, truth.lon_lat_height, truth.ecef_m, strict=True
        )
    ]
    write_text(folder / "points.csv", _csv(["id", "role", "lon_deg", "lat_deg", "height_m", "x_m", "y_m", "z_m"], rows))
    header = ["image", "parameter", "component", "degree", "unit", "value_per_tau"]
    write_text(folder / "eop.csv", _csv(header, writer.orientation(truth)))
    write_text(folder / "options.json", json.dumps(values, indent=2, sort_keys=True) + "\n")


def eop_rows(truth: Truth) -> Rows:
    """True minus metadata of all 27 coefficients, then of the look polynomial (per s^degree) if there is one."""
    rows: Rows = []
    for image, correction in zip(truth.image_ids, truth.corrections, strict=True):
        for c, (name, unit) in enumerate(zip(COMPONENTS, UNITS, strict=True)):
            for k in range(3):
                value = repr(float(correction.eop[c, k]))
                rows.append([image, parameter_name(3 * c + k), name, str(k), unit, value])
        for axis, coefficients in zip("xy", correction.look, strict=True):
            for k, value in enumerate(coefficients.tolist()):
                rows.append([image, f"psi_{axis}_s{k}", f"psi_{axis}", str(k), "rad", repr(value)])
    return rows


def _csv(header: list[str], rows: list[list[str]]) -> str:
    return "\n".join(",".join(cells) for cells in [header, *rows]) + "\n"


#: A ``Simulation``: one DIMAP 1.1 for each image.
DIMAP: Final = ImageWriter(images_of, eop_rows)
