"""Provenance of a run: inputs with their SHA-256, versions, options, command and time.

No absolute path is recorded, because a result folder may be given to other people.
"""

from __future__ import annotations

import dataclasses
import os
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from fg_orient.formats.atomic import in_all_forms
from fg_orient.formats.text_files import sha256_of
from fg_orient.model.installation import stamp

if TYPE_CHECKING:
    from fg_orient.model.block import Block
    from fg_orient.sensors.correction import HeightSurface

#: Version of ``manifest.json`` in folders with this record.
MANIFEST_SCHEMA: Final = 1
#: Files of an earlier result from which an adjustment can start.
EARLIER: Final = ("result.json", *in_all_forms("eop", "points"), "covariance.npz")


def provenance(block: Block, folder: Path, command: Sequence[str]) -> dict[str, Any]:
    """Make the provenance of a run.

    Parameters
    ----------
    block : Block
    folder : Path
        Folder of the project; inputs are named relative to it.
    command : sequence of str
        Words of the command line.

    Returns
    -------
    dict
        ``inputs`` (file, sha256), ``versions``, ``options``, ``command``, ``date_time_utc``,
        ``platform``.
    """
    return {
        "inputs": [{"file": relative(source.path, folder), "sha256": source.sha256} for source in block.sources],
        **stamp(command),
        "manifest": MANIFEST_SCHEMA,
        "platform": f"{platform.system()} {platform.machine()}",
        "options": dataclasses.asdict(block.options),
    }


def ground_system(block: Block, folder: Path) -> dict[str, Any]:
    """Return the entry ``ground`` of the record: CRS and zero level of the points.

    A file of the zero level is named relative to the result folder.
    """
    one = block.ground
    geoid = Path(os.path.relpath(Path(one.geoid).resolve(), folder.resolve())).as_posix() if one.geoid else None
    return {"ground": {"crs": one.crs or None, "geoid": geoid, "undulation_m": one.undulation_m}}


def how_to_repeat(
    folder: Path,
    options: Mapping[str, object],
    execution: Mapping[str, Any],
    dem_control: tuple[HeightSurface, float] | None,
    earlier: tuple[Path, bool] | None = None,
) -> dict[str, Any]:
    """Return all arguments of a run except its project file; ``fg_orient.orientation.replay`` reads them.

    Parameters
    ----------
    folder : Path
        Folder of the project.
    options : mapping
        Options that replaced options of the project file; a value None did not replace one.
    execution : mapping
        ``parts``, ``workers`` and ``cluster``. The numbers of the result depend only on ``parts``.
    dem_control : (HeightSurface, float), optional
        See :func:`fg_orient.orientation.run.run_project`.
    earlier : (Path, bool), optional
        Folder of an earlier result, and whether its covariance matrix is a prior.

    Returns
    -------
    dict
        ``options``, ``parts``, ``in_parts``, and ``dem_control`` (file, sha256, sigma_m,
        vertical_crs; or None). With an earlier result also ``start`` (folder, prior, and
        files with their SHA-256).
    """
    dem = None
    if dem_control is not None:
        surface, sigma_m = dem_control
        dem = {"file": relative(surface.path, folder), "sha256": sha256_of(Path(surface.path)), "sigma_m": sigma_m,
               "vertical_crs": getattr(surface, "vertical_crs", "")}  # fmt: skip
    start = {}
    if earlier is not None:
        path, prior = earlier
        files = {name: sha256_of(path / name) for name in EARLIER if (path / name).is_file()}
        start = {"start": {"folder": relative(str(path), folder), "prior": prior, "files": files}}
    return {
        "options": {name: value for name, value in options.items() if value is not None},
        "parts": execution.get("parts"),
        "in_parts": any(execution.get(name) is not None for name in ("parts", "workers", "cluster")),
        "dem_control": dem,
        **start,
    }


def relative(path: str, folder: Path) -> str:
    """Return the path of a file relative to a folder.

    If this is not possible, return the name of the file.
    """
    full, base = Path(path).absolute(), folder.absolute()
    return full.relative_to(base).as_posix() if full.is_relative_to(base) else full.name
