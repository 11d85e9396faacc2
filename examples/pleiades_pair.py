"""Adjust the real Pléiades-1A images of Zonguldak with ten control points; all other points are check points.

    python examples/pleiades_pair.py DATA_DIR [--first ID] [--json]

DATA_DIR contains DIMAP v2 files ``DIM_*img<k>.XML`` and ``points_img<k>.csv`` (point_id, line and
column 1-based, ECEF metres) for two or more images. Ten control points are chosen by
farthest-point sampling in ECEF. Each point in turn (or only ``--first``) is the first point. The sigma of point
coordinates is 0.3 m per axis, because it includes the identification in the image. With ``--point-sigma 0.05``
the solution is reported as not trustworthy. Data: GeoEtrim group, academic use.
"""

from __future__ import annotations

import argparse
import csv
import json
import re
import sys
from pathlib import Path

import numpy as np

import fg_orient as fg
from fg_orient.geodesy import ecef_to_geodetic, enu_from_ecef
from fg_orient.model.block import Coordinates, WithheldCoordinates
from fg_orient.sensors.initial import all_rays, nearest_points

SETS = (2, 10, 9, 16, 1, 15)
IMAGE_SIGMA_PX = 0.3
N_CONTROL = 10
DIMAP_FIRST_PIXEL = 1.0  # coordinates of the first pixel in the point files


class Scene:
    """Images, point ids, ECEF coordinates and observations of a folder."""

    def __init__(self, folder: Path) -> None:
        numbers = sorted(
            int(found.group(1)) for path in folder.glob("DIM_*.XML") if (found := re.search(r"img(\d+)", path.name))
        )
        numbers = [k for k in numbers if (folder / f"points_img{k}.csv").is_file()]
        if len(numbers) < 2:
            raise SystemExit(f"{folder}: fewer than two images with DIM_*img<k>.XML and points_img<k>.csv")
        self.images, tables = [], []
        for k in numbers:
            path = next(folder.glob(f"DIM_*img{k}.XML"))
            self.images.append(fg.Image(f"img{k}", fg.read_sensor(path)))
            with (folder / f"points_img{k}.csv").open(encoding="utf-8") as stream:
                tables.append({row["point_id"]: row for row in csv.DictReader(stream)})
        self.ids = tuple(dict.fromkeys(i for table in tables for i in table))
        self.ecef_m = np.array(
            [[float(next(t[i] for t in tables if i in t)[f"{axis}_ecef_m"]) for axis in "XYZ"] for i in self.ids]
        )
        rows = [(k, j, t[i]) for k, t in enumerate(tables) for j, i in enumerate(self.ids) if i in t]
        sigma = np.full(len(rows), IMAGE_SIGMA_PX)
        self.observations = fg.ImagePoints(
            np.array([k for k, _, _ in rows]),
            np.array([j for _, j, _ in rows]),
            np.array([float(row["line"]) for *_, row in rows]) - DIMAP_FIRST_PIXEL,
            np.array([float(row["col"]) for *_, row in rows]) - DIMAP_FIRST_PIXEL,
            sigma,
            sigma,
        )

    def block(self, control: list[int], point_sigma_m: float) -> fg.Block:
        """Make the block with these control points; all other points are check points."""
        n = len(self.ids)
        is_control = np.isin(np.arange(n), control)
        sigma = np.full((n, 3), point_sigma_m)
        known = Coordinates(
            np.where(is_control[:, None], self.ecef_m, np.nan),
            np.where(is_control[:, None], sigma, np.nan),
            np.zeros(n, bool),
        )
        check = np.flatnonzero(~is_control)
        withheld = WithheldCoordinates(
            tuple(self.ids[j] for j in check),
            lambda: Coordinates(self.ecef_m[check], sigma[check], np.zeros(len(check), bool)),
        )
        roles = tuple(fg.Role.CONTROL if c else fg.Role.CHECK for c in is_control)
        points = fg.GroundPoints(self.ids, roles, known)
        return fg.Block("pleiades", tuple(self.images), points, self.observations, withheld)


def farthest_points(ecef_m: np.ndarray, first: int, count: int) -> list[int]:
    """Farthest-point sampling: each further point has the largest distance from all chosen points."""
    chosen = [first]
    distance = np.linalg.norm(ecef_m - ecef_m[first], axis=1)
    while len(chosen) < count:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(ecef_m - ecef_m[chosen[-1]], axis=1))
    return chosen


def direct_geolocation(scene: Scene) -> dict[str, float]:
    """Differences of points intersected with the metadata orientation: mean and standard deviation, metres."""
    centre, direction = all_rays(tuple(scene.images), scene.observations)
    found, _ = nearest_points(centre, direction, scene.observations.point, len(scene.ids))
    d = np.einsum("nij,nj->ni", enu_from_ecef(*ecef_to_geodetic(scene.ecef_m)[:2]), found - scene.ecef_m)
    out = {f"mean_{axis}_m": float(d[:, k].mean()) for k, axis in enumerate(("east", "north", "up"))}
    out |= {f"sd_{axis}_m": float(d[:, k].std(ddof=1)) for k, axis in enumerate(("east", "north", "up"))}
    out["rmse_horizontal_m"] = float(np.sqrt(np.mean(d[:, 0] ** 2 + d[:, 1] ** 2)))
    return out


def run(scene: Scene, first: int, eop_set: int, point_sigma_m: float) -> dict[str, object]:
    """One adjustment: accuracy at the check points, sigma0, and suspicious points."""
    control = farthest_points(scene.ecef_m, first, N_CONTROL)
    solution = fg.adjust(scene.block(control, point_sigma_m), eop_set=eop_set)
    check = solution.accuracy.check
    figures = check.statistics()
    return {
        "first": scene.ids[first],
        "control": [scene.ids[j] for j in control],
        "status": solution.status.value,
        "reason": solution.reason,
        "iterations": solution.iterations,
        "sigma0": solution.sigma0,
        "sigma0_interval_99_9": list(solution.sigma0_interval),
        **{f"rmse_{axis}_m": figures[f"rmse_{axis}_m"] for axis in ("east", "north", "up")},
        "beyond_3_sigma": [{"id": i, "axis": a, "difference_m": d, "ratio": r} for i, a, d, r in check.suspicious()],
        "largest": [{"id": i, "east_m": e, "north_m": n, "up_m": u} for i, e, n, u in check.largest()],
    }


def summarise(runs: list[dict[str, object]]) -> dict[str, object]:
    """Medians and maxima over the runs of one set."""
    out: dict[str, object] = {"runs": len(runs)}
    for axis in ("east", "north", "up"):
        values = np.array([r[f"rmse_{axis}_m"] for r in runs], float)
        out[f"median_rmse_{axis}_m"] = float(np.median(values))
        out[f"max_rmse_{axis}_m"] = float(values.max())
    out["median_sigma0"] = float(np.median(np.array([r["sigma0"] for r in runs], float)))
    out["converged"] = sum(r["status"] == "converged" for r in runs)
    return out


def main() -> int:
    """Run all adjustments and print their results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data_dir", type=Path)
    parser.add_argument("--first", help="id of the first control point; default: each in turn")
    parser.add_argument("--point-sigma", type=float, default=0.3, help="sigma of the ground points per axis, m")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    scene = Scene(given.data_dir)
    if given.first is not None and given.first not in scene.ids:
        raise SystemExit(f"{given.data_dir}: no point {given.first}; ids run from {scene.ids[0]} to {scene.ids[-1]}")
    starts = range(len(scene.ids)) if given.first is None else [scene.ids.index(given.first)]
    direct = direct_geolocation(scene)
    runs = {number: [run(scene, first, number, given.point_sigma) for first in starts] for number in SETS}
    summary = {str(number): summarise(found) for number, found in runs.items()}
    if given.json:
        details = {str(number): found[0] for number, found in runs.items()} if given.first is not None else {}
        images = [image.id for image in scene.images]
        print(json.dumps({"images": images, "direct": direct, "sets": summary, "details": details}, indent=1))
    else:
        show(direct, summary, runs, given.first)
    return 0


def show(
    direct: dict[str, float],
    summary: dict[str, dict[str, object]],
    runs: dict[int, list[dict[str, object]]],
    first: str | None,
) -> None:
    """Print the tables."""
    print("direct geolocation, no control (mean +- scatter, m): " + ", ".join(
        f"{axis} {direct[f'mean_{axis}_m']:+.2f} +- {direct[f'sd_{axis}_m']:.2f}" for axis in ("east", "north", "up")
    ))  # fmt: skip
    print(f"{'set':>4} {'runs':>5}   median RMSE E / N / U (m)     largest RMSE E / N / U (m)   sigma0")
    for number, row in summary.items():
        median = " / ".join(f"{row[f'median_rmse_{a}_m']:.2f}" for a in ("east", "north", "up"))
        largest = " / ".join(f"{row[f'max_rmse_{a}_m']:.2f}" for a in ("east", "north", "up"))
        print(f"{number:>4} {row['runs']:>5}   {median:<28} {largest:<28} {row['median_sigma0']:.2f}")
    one = runs[10][0]
    if one["status"] != "converged":
        print(f"{one['status']}: {one['reason']}")
    if first is not None:
        print(f"set 10, first control point {first}: check coordinates beyond 3 sigma of the difference")
        for row in one["beyond_3_sigma"] or [{"id": "none", "axis": "", "difference_m": 0.0, "ratio": 0.0}]:
            print(f"  {row['id']:>5} {row['axis']:<7} {row['difference_m']:+.2f} m, ratio {row['ratio']:.1f}")
        print("the five largest differences, metres (they lie in the weak Up direction)")
        for row in one["largest"]:
            print(f"  {row['id']:>5} E {row['east_m']:+.2f} N {row['north_m']:+.2f} U {row['up_m']:+.2f}")


if __name__ == "__main__":
    sys.exit(main())
