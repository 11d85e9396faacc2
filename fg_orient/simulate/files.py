"""Writer of a simulated block in the real file formats, with its truth.

The folder contains metadata of each image (DIMAP 1.1, RPC, frame files), tables ``points`` and
``observations``, and ``project.toml``. ``truth/`` contains the error-free ``points``, ``eop`` (true
minus metadata), ``jitter`` if simulated, and ``options.json``; the adjustment never reads it. The
folder is written completely or not at all.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar

import numpy as np

from fg_orient.formats.atomic import Contents, in_all_forms, require_free, staged_folder, write_text, writing
from fg_orient.formats.dimap_write import write_dimap1
from fg_orient.formats.points_write import write_observations, write_points, write_project
from fg_orient.formats.table_write import require_writer, write_table
from fg_orient.model.arrays import wrong
from fg_orient.model.names import COMPONENTS, TABLE_FORM
from fg_orient.model.parameters import UNITS, parameter_name
from fg_orient.result.plain import write_rows
from fg_orient.sensors.correction import Correction
from fg_orient.simulate.jitter import JITTER_COLUMNS, jitter_rows

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    from fg_orient.model.block import Block
    from fg_orient.model.names import Progress
    from fg_orient.simulate.simulation import Simulation, Truth

Chosen = TypeVar("Chosen", bound="DataclassInstance")

PROJECT_FILE = "project.toml"
CAMERA_FILE: Final = "camera.toml"
#: Contents of a folder of a simulation. Only such a folder may be replaced: a real
#: project has no ``truth/options.json``.
CONTENTS: Final = Contents(
    "truth/options.json",
    (
        PROJECT_FILE,
        *in_all_forms("points", "observations", "truth/points", "truth/eop", "truth/jitter"),
        "*.DIM",
        "truth/options.json",
        "*.tif",
        "*_RPC.TXT",
        CAMERA_FILE,
        "frame*.toml",
    ),
)
#: Names and units of the simulated corrections of RPC and frame images, by the number of all unknowns of such an image.
OTHERS: Final = {
    6: dict.fromkeys(("line_0", "sample_0", "line_l1", "sample_l1"), "px"),
    15: {"rotation_x": "rad", "rotation_y": "rad", "rotation_z": "rad", "centre_x": "m", "centre_y": "m",
         "centre_z": "m", "focal": "px", "principal_sample": "px", "principal_line": "px"},
}  # fmt: skip


@dataclass(frozen=True)
class Scenario(Generic[Chosen]):
    """Kind of synthetic block.

    Parameters
    ----------
    command : str
        Command that makes this kind, for the headers.
    usual : dataclass
        Default options.
    draw : callable
        Function that returns the simulation of options; its second argument is called
        with (done, of, text), or is None.
    """

    command: str
    usual: Chosen
    draw: Callable[[Chosen, Progress | None], Simulation]

    def block(self, options: Chosen | None = None) -> tuple[Block, Truth]:
        """Make the block in memory.

        Returns
        -------
        block : Block
            Block, equal to a block read from the files.
        truth : Truth
            True ground points (ECEF, m), pixels without noise, corrections of each sensor in its own form.
        """
        simulation = self.draw(self._chosen(options), None)
        return simulation.block(), simulation.truth

    def _chosen(self, options: Chosen | None) -> Chosen:
        """Return the given or default options; InputError for other ones."""
        if options is None:
            return self.usual
        if not isinstance(options, type(self.usual)):
            raise wrong("options", type(options).__name__, type(self.usual).__name__)
        return options

    def write(
        self,
        out: str | Path,
        options: Chosen | None = None,
        *,
        overwrite: bool = False,
        progress: Progress | None = None,
        more: Callable[[Path, Simulation], None] | None = None,
    ) -> Path:
        """Write the block: metadata files, points, observations, project file and ``truth/``.

        Parameters
        ----------
        out : str or Path
            Folder to make; an unusable folder is refused before anything is drawn.
        options : dataclass, optional
            The options, which are also written to the headers and to ``truth/options.json``.
        overwrite : bool
            Replace a folder that an earlier simulation wrote (``truth/options.json``) and
            that contains nothing else.
        progress : callable, optional
            Function that is called with (done, of, text); each part of the work counts from 0.
        more : callable, optional
            Function that writes further files into the folder.

        Returns
        -------
        Path
            The project file.

        Raises
        ------
        InputError
            The folder exists, or cannot be written. Nothing remains of a folder that was not completed.
        """
        target, chosen = Path(out), self._chosen(options)
        require_free(target, overwrite=overwrite, contents=CONTENTS)
        form = getattr(chosen, "tables", TABLE_FORM)
        require_writer(target / f"points.{form}")
        simulation, values = self.draw(chosen, progress), {"command": self.command, **asdict(chosen)}
        with staged_folder(target, overwrite=overwrite, contents=CONTENTS) as folder:
            _write_block(folder, simulation, values, form, progress)
            with writing(target):
                (folder / "truth").mkdir()
                _write_truth(folder / "truth", simulation, values, form)
            if more is not None:
                more(folder, simulation)
        return target / PROJECT_FILE


def _write_block(
    folder: Path, simulation: Simulation, values: dict[str, Any], form: str, progress: Progress | None
) -> None:
    made = [f"simulated by fg_orient: {values['command']}", f"options: {json.dumps(values, sort_keys=True)}"]
    images = _write_images(folder, simulation, progress)
    ground, truth = simulation.ground, simulation.truth
    known = ground.known[:, None]
    write_points(
        folder / f"points.{form}",
        ground.ids,
        ground.roles,
        np.where(known, ground.measured, np.nan),
        np.where(known, ground.sigma_enu_m, np.nan),
        comments=[*made, "measured values: WGS84, ellipsoidal heights; sigmas at the point", "crs: EPSG:4979"],
    )
    write_observations(
        folder / f"observations.{form}",
        [truth.image_ids[k] for k in simulation.image],
        [ground.ids[j] for j in simulation.point],
        simulation.observed,
        simulation.sigma_px,
        comments=[*made, "(0, 0) is the centre of the first pixel"],
    )
    write_project(
        folder / PROJECT_FILE,
        name=simulation.name,
        images=images,
        points=f"points.{form}",
        observations=f"observations.{form}",
        options=simulation.options,
        comments=made,
    )


def _write_images(folder: Path, simulation: Simulation, progress: Progress | None) -> list[tuple[str, str]]:
    """Write the metadata file of each image, and the camera of the frames.

    Return ids and names of the files.
    """
    from fg_orient.formats.metadata.frame import write_camera, write_frame_file
    from fg_orient.formats.rpc import write_rpc
    from fg_orient.sensors.frame import FrameSensor
    from fg_orient.sensors.rpc_sensor import RpcSensor

    for k, metadata in enumerate(simulation.metadata):
        if progress is not None:
            progress(k, len(simulation.metadata), "metadata files")
        write_dimap1(folder / metadata.file, metadata, dataset_name=f"{simulation.name}, simulated")
    if simulation.interior is not None:
        write_camera(folder / CAMERA_FILE, simulation.interior)
    for sensor in (image.sensor for image in simulation.others):
        if isinstance(sensor, FrameSensor):
            write_frame_file(folder / sensor.file, sensor, CAMERA_FILE)
        elif isinstance(sensor, RpcSensor):
            write_rpc(folder / sensor.file, sensor.model)
    files = [metadata.file for metadata in simulation.metadata] + [image.sensor.file for image in simulation.others]
    return list(zip(simulation.truth.image_ids, files, strict=True))


def _write_truth(folder: Path, simulation: Simulation, values: dict[str, Any], form: str) -> None:
    truth = simulation.truth
    names = ("lon_deg", "lat_deg", "height_m", "x_m", "y_m", "z_m")
    numbers = zip(names, (*truth.lon_lat_height.T, *truth.ecef_m.T), strict=True)
    write_table(folder / f"points.{form}", {"id": truth.point_ids, "role": simulation.ground.roles, **dict(numbers)})
    eop = [row for image in zip(truth.image_ids, truth.corrections, strict=True) for row in _orientation(*image)]
    write_rows(folder / f"eop.{form}", ("image", "parameter", "component", "degree", "unit", "value_per_tau"), eop)
    waves = [row for image in zip(truth.image_ids, truth.corrections, strict=True) for row in jitter_rows(*image)]
    if waves:
        write_rows(folder / f"jitter.{form}", JITTER_COLUMNS, waves)
    write_text(folder / "options.json", json.dumps(values, indent=2, sort_keys=True) + "\n")


def _orientation(image: str, correction: Any) -> list[tuple[object, ...]]:
    """Return the true corrections of one image: true orientation minus metadata.

    Pushbroom image: all 27 coefficients, then the look polynomial (per s^degree), if any.
    Other images: :data:`OTHERS`.
    """
    if not isinstance(correction, Correction):
        named = zip(OTHERS[len(correction)].items(), correction.tolist(), strict=False)
        return [(image, name, name, None, unit, value) for (name, unit), value in named]
    rows = list[tuple[object, ...]]()
    for c, (name, unit) in enumerate(zip(COMPONENTS, UNITS, strict=True)):
        for k in range(3):
            rows.append((image, parameter_name(3 * c + k), name, k, unit, float(correction.eop[c, k])))
    for axis, coefficients in zip("xy", correction.look, strict=True):
        for k, value in enumerate(coefficients.tolist()):
            rows.append((image, f"psi_{axis}_s{k}", f"psi_{axis}", k, "rad", value))
    return rows
