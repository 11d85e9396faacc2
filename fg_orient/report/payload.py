"""Data of the live drawings of a page.

Coordinates are Float32 in base64, little endian; a column that is one value everywhere is that value. Words are JSON.
"""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from markupsafe import Markup

from factors.arrays import Array, Index, Mask
from fg_orient.report.maps import KM_PER_DEGREE, footprints, shrink_at, view_of
from fg_orient.result.record import Result

#: Maximum number of image points in the page; of more the page contains a sample.
LIMIT: Final = 200_000
#: Bytes of all points in the page, which with its other parts stays below 8 MB; bytes of an image point and of a point.
BUDGET: Final = 5_000_000
RAY_BYTES: Final = 40
POINT_BYTES: Final = 40
#: Seed of that sample.
SEED: Final = 1
#: Limit of flagged residuals, in their own sigmas.
FLAG: Final = 3.0
#: Order of the points in the page, and of the roles' numbers.
ROLES: Final = ("control", "check", "tie")


@dataclass(frozen=True)
class Payload:
    """Data of the drawings of the script.

    Parameters
    ----------
    data : dict
        JSON, arrays packed.
    words : str
        Sentence on omitted image points; empty if there are none.
    """

    data: dict[str, Any]
    words: str

    def json(self) -> Markup:
        """Text of the data element; no character in it ends the element."""
        text = json.dumps(self.data, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
        for sign in "<>&":
            text = text.replace(sign, f"\\u{ord(sign):04x}")
        return Markup(text)


def pack(values: npt.ArrayLike, kind: str = "f4") -> dict[str, Any]:
    """Pack a column as base64 of a little-endian typed array, or as its one value.

    Parameters
    ----------
    values : (n,) array
    kind : str
        ``f4``, ``u1``, ``u2`` or ``u4``.
    """
    column = np.ascontiguousarray(values, dtype=f"<{kind}")
    if len(column) > 1 and np.isfinite(column[0]) and (column == column[0]).all():
        return {"one": float(column[0]), "n": len(column)}
    return {"kind": kind, "n": len(column), "base64": base64.b64encode(column.tobytes()).decode()}


def payload(result: Result) -> Payload | None:
    """Pack points, footprints and image points; None for a block without geographic coordinates."""
    located = np.isfinite(result.points.figures["lon_deg"])
    if not located.any():
        return None
    kept, more = chosen_points(result)
    rays, words = chosen_rays(result, kept)
    words = " ".join(filter(None, (words, more)))
    place = {name: k for k, name in enumerate(result.points.words["id"])}
    of_ray = np.fromiter((place[result.residuals.words["id"][k]] for k in rays.tolist()), np.intp, len(rays))
    role = _role_numbers(result)
    if words:  # tie points without an image point in the page are left out
        seen = np.zeros(len(located), bool)
        seen[of_ray] = True
        located &= kept & (seen | (role < 2))
    points = np.flatnonzero(located)
    points = points[np.argsort(role[points], kind="stable")]
    number = np.full(len(located), -1, np.intp)
    number[points] = np.arange(len(points))
    drawn = number[of_ray] >= 0
    places = result.points.numbers("lon_deg", "lat_deg")
    everything, view = np.vstack([places, *footprints(result.record)]), view_of(result)
    centre = 0.5 * (np.nanmin(everything, axis=0) + np.nanmax(everything, axis=0))
    data = {
        "view": None if view is None else np.round(_kilometres(view, centre), 4).tolist(),
        "points": _point_columns(result, points, role[points], centre),
        "rays": _ray_columns(result, rays[drawn], number[of_ray[drawn]]),
        "images": [
            {"id": image["id"], "lines": image["n_lines"], "samples": image["n_samples"],
             "foot": np.round(_kilometres(np.array(image["footprint_lon_lat_deg"], float), centre), 4).tolist()}
            for image in result.record["images"]
        ],
        "centre": centre.tolist(), "kmPerDegree": [KM_PER_DEGREE * shrink_at(float(centre[1])), KM_PER_DEGREE],
        "roles": ROLES,
    }  # fmt: skip
    return Payload(data, words)


def chosen_rays(result: Result, points: Mask) -> tuple[Index, str]:
    """Rows of the image points in the page, and a sentence on those that are not; flagged ones before others.

    ``points`` (N,): those of :func:`chosen_points`.
    """
    n, known = len(result.residuals), int(np.count_nonzero(points & (_role_numbers(result) < 2)))
    if n <= LIMIT and n * RAY_BYTES + len(result.points) * POINT_BYTES <= BUDGET:
        return np.arange(n), ""
    most = max(BUDGET - known * POINT_BYTES, 0) // (RAY_BYTES + POINT_BYTES)
    ratio = np.nan_to_num(np.abs(result.normalised[0]).max(axis=1), nan=0.0)
    rows, flagged = _flagged_first(ratio > FLAG, ratio, most, min(LIMIT, most))
    words = (
        f"The moving drawings hold {len(rows):,} of {n:,} image points: {_share(flagged, ratio > FLAG)} with a "
        f"residual beyond {FLAG:g} σ and a random sample of the others (seed {SEED}), and the tie points of these "
        "image points. The tables in the folder hold all."
    )
    return rows, words


def chosen_points(result: Result) -> tuple[Mask, str]:
    """Points (N,) that may be in the page, and a sentence on control and check points that are not."""
    known, axes = np.flatnonzero(_role_numbers(result) < 2), ("east", "north", "up")
    out, most = np.ones(len(result.points), bool), BUDGET // 2 // POINT_BYTES
    if len(known) <= most:
        return out, ""
    differences, sigma, own = (
        result.points.numbers(*(name.format(axis) for axis in axes))[known]
        for name in ("difference_{}_m", "sigma_{}_m", "own_sigma_{}_m")
    )
    ratio = np.nan_to_num(np.abs(differences) / np.sqrt(sigma**2 + own**2)).max(axis=1)
    rows, flagged = _flagged_first(ratio > FLAG, ratio, most, most)
    out[np.delete(known, rows)] = False
    return out, (
        f"Of {len(known):,} control and check points they hold {len(rows):,}: {_share(flagged, ratio > FLAG)} with a "
        f"difference beyond {FLAG:g} σ and a random sample of the others."
    )


def _role_numbers(result: Result) -> Index:
    """Position in :data:`ROLES` of the role of each point (N,)."""
    number = {word: k for k, word in enumerate(ROLES)}
    return np.array([number.get(word, 2) for word in result.points.words["role"]], np.intp)


def _flagged_first(flagged: Mask, ratio: Array, most: int, room: int) -> tuple[Index, int]:
    """Rows, and how many are flagged: the largest flagged ones (at most ``most``), then others up to ``room``."""
    worst, others = np.flatnonzero(flagged), np.flatnonzero(~flagged)
    worst = worst[np.argsort(-ratio[worst], kind="stable")][:most]
    left = min(max(room - len(worst), 0), len(others))
    sample = np.random.default_rng(SEED).choice(others, left, replace=False)
    return np.sort(np.append(worst, sample)), len(worst)


def _share(kept: int, flagged: Mask) -> str:
    """Words on the number of flagged ones."""
    n = int(np.count_nonzero(flagged))
    return f"all {n:,}" if kept == n else f"the largest {kept:,} of {n:,}"


def _kilometres(lon_lat_deg: Array, centre: Array) -> Array:
    """Kilometres East and North of the centre, equirectangular."""
    return np.asarray((lon_lat_deg - centre) * KM_PER_DEGREE * np.array([shrink_at(float(centre[1])), 1.0]))


def _point_columns(result: Result, rows: Index, role: Index, centre: Array) -> dict[str, Any]:
    """Columns of the points; differences of control and check points only, which come first."""
    table = result.points
    km = _kilometres(table.numbers("lon_deg", "lat_deg", rows=rows), centre)
    known = int(np.searchsorted(role, 2))
    out: dict[str, Any] = {"id": [table.words["id"][k] for k in rows.tolist()], "role": pack(role, "u1"),
                           "x": pack(km[:, 0]), "y": pack(km[:, 1])}  # fmt: skip
    for axis in ("east", "north", "up"):
        out[axis] = pack(table.figures[f"difference_{axis}_m"][rows[:known]])
        out[f"sigma_{axis}"] = pack(table.figures[f"sigma_{axis}_m"][rows])
    return out


def _ray_columns(result: Result, rows: Index, point: Index) -> dict[str, Any]:
    """Columns of the image points, those of an image together."""
    table = result.residuals
    image = table.codes("image", [facts["id"] for facts in result.record["images"]])[rows]
    order = np.argsort(image, kind="stable")
    rows, point, image = rows[order], point[order], image[order]
    columns = {"line": "line", "sample": "sample", "vl": "v_line_px", "vs": "v_sample_px"}
    own, tested = result.normalised[0][rows], result.normalised[1]
    return {
        "image": pack(image, "u2"), "point": pack(point, "u4"),
        **{name: pack(table.figures[column][rows]) for name, column in columns.items()},
        "wl": pack(own[:, 0]), "ws": pack(own[:, 1]), "tested": tested,
    }  # fmt: skip
