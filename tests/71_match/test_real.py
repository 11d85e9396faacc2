"""Real pairs are matched from pixels alone: the Pléiades pair of s2p with SIFT and its DSM, Mont Ventoux with SRTM."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.orientation.match.job import match_project
from fg_orient.quality.accuracy import rms_px, y_parallaxes
from fg_orient.sensors.surface import RasterDem
from tests.support.rendered_pair import write_project

pytestmark = [pytest.mark.real_data, pytest.mark.slow, pytest.mark.truth]
#: Edge of the cells on which two sets of points are compared, DSM pixels of 0.5 m.
CELL = 20


def nmad(values: np.ndarray) -> float:
    """Return the normalised median absolute deviation."""
    return float(1.4826 * np.median(np.abs(values - np.median(values))))


def adjusted(project: Path) -> tuple[Any, np.ndarray, float]:
    """Adjust with defaults; return the solution, longitude, latitude and height of its points, and y-parallax RMS."""
    solution = fg.adjust(fg.read_project(project))
    problem = solution.problem
    parallax = rms_px(y_parallaxes(problem, solution.state)[1])
    geodetic = np.stack(fg.geodesy.ecef_to_geodetic(problem.origin_m + solution.state.ground), axis=1)
    return solution, geodetic, parallax


def dsm_differences(file: Path, geodetic: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the heights above the DSM and cells (n, 2) of the points on it."""
    dsm = RasterDem(file)
    d = geodetic[:, 2] - dsm.height_m(*geodetic[:, :2].T)
    good = np.isfinite(d)
    return d[good], np.stack(dsm.cell(*geodetic[good, :2].T), axis=1).astype(int) // CELL


def test_pleiades_pair_of_s2p(real_data: Path, tmp_path: Path) -> None:
    """Matches of the Pléiades pair are as accurate as SIFT points in the same cells.

    The DSM is of these images, so it is not independent.
    """
    source = real_data / "s2p-pair"
    for name in ("matched", "sift"):
        (tmp_path / name).mkdir()
        for image in ("img_01.tif", "img_02.tif"):
            shutil.copyfile(source / image, tmp_path / name / image)
        write_project(tmp_path / name, {"im1": "img_01.tif", "im2": "img_02.tif"})
    record = match_project(tmp_path / "matched" / "project.toml")
    shutil.copyfile(source / "observations.csv", tmp_path / "sift" / "observations.csv")
    shutil.copyfile(tmp_path / "matched" / "project.toml", tmp_path / "sift" / "project.toml")
    (solution, ours, parallax), (_, theirs, sift_parallax) = (
        adjusted(tmp_path / name / "project.toml") for name in ("matched", "sift")
    )
    d, cells = dsm_differences(source / "dsm.tif", ours)
    d_sift, cells_sift = dsm_differences(source / "dsm.tif", theirs)
    common = {tuple(c) for c in cells.tolist()} & {tuple(c) for c in cells_sift.tolist()}
    same = np.array([tuple(c) in common for c in cells.tolist()])
    same_sift = np.array([tuple(c) in common for c in cells_sift.tolist()])
    kept = record["pairs"][0]["accepted"] / record["pairs"][0]["least_squares"]
    print(f"\n{record['n_points']} points, {len(d)} on the DSM, kept {100 * kept:.0f} %, sigma0 {solution.sigma0:.3f}")
    print(f"y-parallax {parallax:.3f} (SIFT {sift_parallax:.3f}) px, NMAD {nmad(d):.3f} m, bias {np.median(d):+.3f} m")
    print(f"on {len(common)} common cells {nmad(d[same]):.3f} (SIFT {nmad(d_sift[same_sift]):.3f}) m")
    assert record["n_points"] >= 3000 and len(d) >= 1500
    assert parallax <= 0.35
    assert nmad(d[same]) <= nmad(d_sift[same_sift]) + 0.02
    assert abs(np.median(d)) <= 0.3
    assert kept >= 0.7
    assert 0.8 <= solution.sigma0**2 <= 1.25


def test_ventoux_against_srtm(real_data: Path, tmp_path: Path) -> None:
    """Matches of two crops of Mont Ventoux have a y-parallax below 0.35 px and agree with SRTM within 10 m.

    The crops have 500 lines and overlap on 197 m x 77 m, four cells of SRTM. The medians of the four cells lie between
    -8 and +10 m (by plain SIFT points between -6 and +11 m), and an error of the vendor's orientation of 1 px is 2 m of
    height: within some metres SRTM does not test the matching.
    """
    source = real_data / "shareloc-ventoux"
    for side in ("left", "right"):
        shutil.copyfile(source / f"{side}_image.tif", tmp_path / f"{side}.tif")
        write_rpc_of_geom(source / f"{side}_image.geom", tmp_path / f"{side}_RPC.TXT")
    write_project(tmp_path, {side: f"{side}_RPC.TXT" for side in ("left", "right")})
    record = match_project(tmp_path / "project.toml")
    solution, geodetic, parallax = adjusted(tmp_path / "project.toml")
    geoid, srtm = (RasterDem(source / name).height_m(*geodetic[:, :2].T) for name in ("egm96_15.gtx", "N44E005.hgt"))
    d = geodetic[:, 2] - geoid - srtm
    print(f"\n{record['n_points']} points, y-parallax {parallax:.3f} px, sigma0 {solution.sigma0:.3f}, "
          f"SRTM: median {np.median(d):+.2f} m, NMAD {nmad(d):.2f} m")  # fmt: skip
    assert record["n_points"] >= 300
    assert parallax <= 0.35
    assert 0.8 <= solution.sigma0**2 <= 1.25
    assert abs(np.median(d)) <= 10.0


def write_rpc_of_geom(geom: Path, target: Path) -> None:
    """Write the RPC of an OTB file as text."""
    value = dict(re.findall(r"^(\S+):\s+(\S+)", geom.read_text("utf-8"), re.MULTILINE))
    lines = [f"{a.upper()}_{b.upper()}: {value[f'{g}_{b}']}"
             for a, g in (("line", "line"), ("samp", "samp"), ("lat", "lat"), ("long", "long"), ("height", "height"))
             for b in ("off", "scale")]  # fmt: skip
    for axis in ("line", "samp"):
        for part in ("num", "den"):
            lines += [
                f"{axis}_{part}_coeff_{k + 1}: {value[f'{axis}_{part}_coeff_{k:02d}']}".upper() for k in range(20)
            ]
    target.write_text("\n".join(lines) + "\n", "utf-8")
