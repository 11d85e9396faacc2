"""The real Pléiades pair is a project folder with 86 surveyed points, of which every eighth is control."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from fg_orient.formats.points_write import write_observations, write_points, write_project
from fg_orient.model.block import Role


def pleiades_project(real_data: Path, folder: Path) -> tuple[Path, npt.NDArray[np.float64]]:
    """Write the project; give its file and the ECEF coordinates (86, 3) of the points, m."""
    source = real_data / "geoetrim-pleiades"
    tables = {k: np.genfromtxt(source / f"points_img{k}.csv", delimiter=",", names=True) for k in (1, 3)}
    ids = [str(int(i)) for i in tables[1]["point_id"]]
    ecef = np.stack([tables[1][f"{axis}_ecef_m"] for axis in "XYZ"], axis=1)
    roles = [Role.CONTROL if k % 8 == 0 else Role.CHECK for k in range(86)]
    write_points(folder / "points.csv", ids, roles, ecef, np.full((86, 3), 0.3), kind="geocentric")
    pixels = np.concatenate([np.stack([tables[k]["line"] - 1, tables[k]["col"] - 1], axis=1) for k in (1, 3)])
    images = ["img1"] * 86 + ["img3"] * 86
    write_observations(folder / "observations.csv", images, ids * 2, pixels, np.full((1, 2), 0.3))
    metadata = [(f"img{k}", str(source / f"DIM_PHR1A_derived_img{k}.XML")) for k in (1, 3)]
    write_project(folder / "project.toml", name="pair", images=metadata, crs="EPSG:4978")
    return folder / "project.toml", ecef
