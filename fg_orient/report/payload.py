"""Data of the live drawings of a page.

Columns are numbers of 1 to 4 bytes in base64, little endian. A column with the same value everywhere contains
this value once. Positions are whole numbers of steps in 3 bytes; their resolution is as good as
Float32. Numbers of points are stored as differences. Residuals and standard deviations are Float32. If
not all image points fit, they are Float16, with three digits. Texts are JSON.
"""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
from markupsafe import Markup

from factors.arrays import Array, Index, Mask
from fg_orient.report.maps import footprints, image_view, km_per_degree, shrink_at, view_of
from fg_orient.result.record import Result

#: Maximum number of image points in the page. If there are more, the page contains a sample.
LIMIT: Final = 200_000
#: Maximum number of bytes of all points in the page, so that the whole page stays below 8 MB.
BUDGET: Final = 6_500_000
#: Maximum number of control and check points in the page. If there are more, the page contains the
#: points with the largest differences and a sample.
MOST_KNOWN: Final = 12_000
#: Number of steps from the smallest to the largest coordinate.
STEPS: Final = 2**24 - 1
#: Seed of that sample.
SEED: Final = 1
#: A residual is flagged if it exceeds this number of its own sigmas.
FLAG: Final = 3.0
#: Order of the roles: the points in the page are sorted by role, and roles are numbered in this order.
ROLES: Final = ("control", "check", "tie")


class Width(NamedTuple):
    """Bytes of an image point and of a ground point (without its id) in the page, and number format of residuals."""

    ray: int
    point: int
    kind: str


#: Bytes of the differences of a control or check point.
KNOWN: Final = 16
#: Number formats if the page can contain all image points.
FINE: Final = Width(31, 24, "f4")
#: Number formats if the page cannot contain all image points.
COARSE: Final = Width(21, 16, "f2")


@dataclass(frozen=True)
class Payload:
    """Data that the script of the page draws.

    Parameters
    ----------
    data : dict
        JSON, arrays packed.
    words : str
        Sentence on omitted image points; empty if all are included.
    """

    data: dict[str, Any]
    words: str

    def json(self) -> Markup:
        """Text of the data element; it contains no character that could end the element."""
        text = json.dumps(self.data, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
        for sign in "<>&":
            text = text.replace(sign, f"\\u{ord(sign):04x}")
        return Markup(text)


def pack(values: npt.ArrayLike, kind: str = "f4") -> dict[str, Any]:
    """Pack a column as base64 of a little-endian typed array, or as a single value if all are equal.

    Parameters
    ----------
    values : (n,) array
    kind : str
        ``f4``, ``f2``; ``u3``: whole steps from the least value, finite; ``d``: differences of whole numbers.
    """
    if kind == "u3":
        return _pack_steps(np.asarray(values, float))
    if kind == "d":
        return _pack_differences(np.asarray(values, np.int64))
    with np.errstate(over="ignore"):  # numbers beyond the range of Float16 become infinite
        column = np.ascontiguousarray(values, dtype=f"<{kind}")
    if len(column) > 1 and np.isfinite(column[0]) and (column == column[0]).all():
        return {"one": float(column[0]), "n": len(column)}
    return {"kind": kind, "n": len(column), "base64": base64.b64encode(column.tobytes()).decode()}


def _pack_steps(values: Array) -> dict[str, Any]:
    """Pack a column of finite numbers in 3 bytes each."""
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 0.0)
    step = (high - low) / STEPS
    if len(values) > 1 and (values == values[0]).all():
        return {"one": float(values[0]), "n": len(values)}
    steps = np.rint((values - low) / (step or 1.0)).astype("<u4")
    data = steps.view(np.uint8).reshape(-1, 4)[:, :3].tobytes()
    return {"kind": "u3", "n": len(values), "low": low, "step": step, "base64": base64.b64encode(data).decode()}


def _pack_differences(values: Index) -> dict[str, Any]:
    """Pack whole numbers as differences: 7 bits in each byte, the lowest first, the sign as the lowest of all.

    The 8th bit states that a byte follows. Numbers below 2^27; for an image with many points most differences need one
    byte.
    """
    change = np.diff(values, prepend=0)
    folded = np.where(change < 0, -2 * change - 1, 2 * change)
    size = 1 + (folded[:, None] >= 128 ** np.arange(1, 4)).sum(axis=1)
    digits = (folded[:, None] >> (7 * np.arange(4))) & 127
    place = np.arange(4)
    digits += 128 * (place < size[:, None] - 1)
    data = digits[place < size[:, None]].astype(np.uint8).tobytes()
    return {"kind": "d", "n": len(values), "base64": base64.b64encode(data).decode()}


def payload(result: Result, used: int = 0) -> Payload | None:
    """Pack points, footprints and image points; None for a block without geographic coordinates.

    ``used``: bytes of :data:`BUDGET` that the pictures need.
    """
    located = np.isfinite(result.points.figures["lon_deg"])
    if not located.any():
        return None
    kept, more = chosen_points(result)
    point = points_of_rays(result)
    rays, words, width = chosen_rays(result, kept, point, used)
    words, of_ray = " ".join(filter(None, (words, more))), point[rays]
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
    record = result.record
    everything, view = np.vstack([places, *footprints(result.record)]), view_of(result)
    centre, degree = 0.5 * (np.nanmin(everything, axis=0) + np.nanmax(everything, axis=0)), km_per_degree(result.record)
    data = {
        "view": None if view is None else np.round(_kilometres(view, centre, result.record), 4).tolist(),
        "points": _point_columns(result, points, role[points], centre, width.kind),
        "rays": _ray_columns(result, rays[drawn], number[of_ray[drawn]], width.kind),
        "images": [
            {"id": image["id"], "lines": image["n_lines"], "samples": image["n_samples"],
             "view": _image_view(result, image),
             "foot": np.round(
                 _kilometres(np.array(image["footprint_lon_lat_deg"], float), centre, record), 4).tolist()}
            for image in record["images"]
        ],
        "centre": centre.tolist(), "kmPerDegree": [degree * shrink_at(float(centre[1])), degree],
        "roles": ROLES,
    }  # fmt: skip
    return Payload(data, words)


def _image_view(result: Result, image: dict[str, Any]) -> list[list[float]] | None:
    """Return the corners (sample, line) of the first view of an image, px; None: the whole image."""
    places = result.residuals.numbers("sample", "line", rows=result.rows[str(image["id"])])
    view = image_view(places, np.array([image["n_samples"] or 0.0, image["n_lines"] or 0.0]))
    return None if view is None else np.round(view, 1).tolist()


def points_of_rays(result: Result) -> Index:
    """Return the row of the ground point of each image point (n,)."""
    place = {name: k for k, name in enumerate(result.points.words["id"])}
    return np.fromiter(map(place.__getitem__, result.residuals.words["id"]), np.intp, len(result.residuals))


def chosen_rays(result: Result, points: Mask, of_ray: Index, used: int = 0) -> tuple[Index, str, Width]:
    """Select the image points of the page; return their rows, a sentence on the other image points, and the width.

    Flagged image points come first, then all image points of points that are drawn at random.
    ``points`` (N,): result of :func:`chosen_points`. ``of_ray`` (n,): row of the point of each image
    point.
    """
    n, known = len(result.residuals), int(np.count_nonzero(points & (_role_numbers(result) < 2)))
    budget = BUDGET - used
    if n <= LIMIT and n * FINE.ray + len(result.points) * _point_bytes(result, FINE) + known * KNOWN <= budget:
        return np.arange(n), "", FINE
    each, rays = _point_bytes(result, COARSE), n / max(int(np.count_nonzero(np.bincount(of_ray))), 1)
    room = max(budget - known * (each + KNOWN), 0)
    ratio = np.nan_to_num(np.abs(result.normalised[0]).max(axis=1), nan=0.0)
    order = np.random.default_rng(SEED).permutation(len(result.points))[of_ray]
    most, largest = int(room / (COARSE.ray + each)), int(room / (COARSE.ray + each / rays))
    rows, flagged = _flagged_first(ratio > FLAG, ratio, most, min(LIMIT, largest), order)
    words = (
        f"The moving drawings hold {len(rows):,} of {n:,} image points: {_share(flagged, ratio > FLAG)} with a "
        f"residual beyond {FLAG:g} σ and those of points drawn at random (seed {SEED}), and the tie points of these "
        "image points. Their residuals and standard deviations have three digits. The tables in the folder hold all."
    )
    return rows, words, COARSE


def _point_bytes(result: Result, width: Width) -> float:
    """Return the bytes of a point in the page, including its id."""
    names = result.points.words["id"]
    return width.point + 3.0 + sum(map(len, names)) / max(len(names), 1)


def chosen_points(result: Result) -> tuple[Mask, str]:
    """Return the points (N,) that may be in the page, and a sentence on omitted control and check points."""
    known, axes = np.flatnonzero(_role_numbers(result) < 2), ("east", "north", "up")
    out, most = (
        np.ones(len(result.points), bool),
        min(int(BUDGET / 2 / (_point_bytes(result, FINE) + KNOWN)), MOST_KNOWN),
    )
    if len(known) <= most:
        return out, ""
    differences, sigma, own = (
        result.points.numbers(*(name.format(axis) for axis in axes))[known]
        for name in ("difference_{}_m", "sigma_{}_m", "own_sigma_{}_m")
    )
    ratio = np.nan_to_num(np.abs(differences) / np.sqrt(sigma**2 + own**2)).max(axis=1)
    order = np.random.default_rng(SEED).permutation(len(ratio))
    rows, flagged = _flagged_first(ratio > FLAG, ratio, most, most, order)
    out[np.delete(known, rows)] = False
    return out, (
        f"Of {len(known):,} control and check points they hold {len(rows):,}: {_share(flagged, ratio > FLAG)} with a "
        f"difference beyond {FLAG:g} σ and a random sample of the others."
    )


def _role_numbers(result: Result) -> Index:
    """Return the position in :data:`ROLES` of the role of each point (N,)."""
    number = {word: k for k, word in enumerate(ROLES)}
    return np.array([number.get(word, 2) for word in result.points.words["role"]], np.intp)


def _flagged_first(flagged: Mask, ratio: Array, most: int, room: int, order: Index) -> tuple[Index, int]:
    """Return rows, at most ``room``: the largest flagged (at most ``most``), then others; and the number of flagged."""
    worst, others = np.flatnonzero(flagged), np.flatnonzero(~flagged)
    worst = worst[np.argsort(-ratio[worst], kind="stable")][:most]
    sample = others[np.argsort(order[others], kind="stable")][: max(room - len(worst), 0)]
    return np.sort(np.append(worst, sample)), len(worst)


def _share(kept: int, flagged: Mask) -> str:
    """Return words on the number of flagged points."""
    n = int(np.count_nonzero(flagged))
    return f"all {n:,}" if kept == n else f"the largest {kept:,} of {n:,}"


def _kilometres(lon_lat_deg: Array, centre: Array, record: dict[str, Any]) -> Array:
    """Return kilometres East and North of the centre, in an equirectangular projection."""
    return np.asarray((lon_lat_deg - centre) * km_per_degree(record) * np.array([shrink_at(float(centre[1])), 1.0]))


def _point_columns(result: Result, rows: Index, role: Index, centre: Array, kind: str) -> dict[str, Any]:
    """Return the columns of the points. Differences exist only for control and check points, which come first."""
    table = result.points
    km = _kilometres(table.numbers("lon_deg", "lat_deg", rows=rows), centre, result.record)
    known = int(np.searchsorted(role, 2))
    out: dict[str, Any] = {
        "id": [table.words["id"][k] for k in rows.tolist()],
        "role": {"counts": np.bincount(role, minlength=len(ROLES)).tolist()},
        "x": pack(km[:, 0], "u3"), "y": pack(km[:, 1], "u3"),
    }  # fmt: skip
    for axis in ("east", "north", "up"):
        out[axis] = pack(table.figures[f"difference_{axis}_m"][rows[:known]])
        out[f"sigma_{axis}"] = pack(table.figures[f"sigma_{axis}_m"][rows], kind)
    return out


def _ray_columns(result: Result, rows: Index, point: Index, kind: str) -> dict[str, Any]:
    """Return the columns of the image points; image points of one image are together."""
    table, images = result.residuals, [facts["id"] for facts in result.record["images"]]
    image = table.codes("image", images)[rows]
    order = np.lexsort((point, image))
    rows, point = rows[order], point[order]
    figures, own, tested = table.figures, result.normalised[0][rows], result.normalised[1]
    return {
        "image": {"counts": np.bincount(image, minlength=len(images)).tolist()},
        "point": pack(point, "d"),
        "line": pack(figures["line"][rows], "u3"), "sample": pack(figures["sample"][rows], "u3"),
        "vl": pack(figures["v_line_px"][rows], kind), "vs": pack(figures["v_sample_px"][rows], kind),
        "wl": pack(own[:, 0], kind), "ws": pack(own[:, 1], kind), "tested": tested,
    }  # fmt: skip
