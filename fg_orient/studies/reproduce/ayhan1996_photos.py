"""Appendices 1 and 2 of Ayhan 1996, from their raw data.

The module recomputes refined image coordinates, intersection, DLT and parallax, and the self-calibrating bundle of 15
control points from their comparator coordinates. Weights, the base and the observed stations of the bundle are not
printed. The weights used here are inferred from the 77 printed mean errors: relative to the printed m0, 1e-4 for a
condition in mm m and 1e-2 for every observed quantity in m, mm and rad. The observed stations are the results printed
in the thesis, so agreement there shows consistency but is no evidence.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from factors.cameras.image_corrections import ideal_points
from fg_orient.closerange.bundle import BundlePhoto, adjust_bundle
from fg_orient.closerange.bundle_result import BundleResult
from fg_orient.closerange.dlt import DltFit, fit_dlt
from fg_orient.closerange.fitting import compare_points
from fg_orient.closerange.intersection import Intersection, intersect_photos, normal_case
from fg_orient.closerange.photo import Photo, PhotoInterior, ayhan_from_rotation, rotation_from_ayhan
from fg_orient.model.constraint import Constraint
from fg_orient.studies.reproduce.verdict import Cells, Recomputed, Values, row_key

N: Final = 49
POINTS: Final = tuple(range(1, N + 1))
CONTROL: Final = (1, 3, 5, 7, 9, 11, 13, 15, 33, 35, 37, 39, 44, 45, 49)
PHOTOS: Final = ("photo 1", "photo 2")
COMPARATOR: Final = ("x1_mm", "z1_mm", "x2_mm", "z2_mm")
REFINED: Final = ("xs1_mm", "zs1_mm", "xs2_mm", "zs2_mm")
GEODETIC: Final = ("x_geodetic_m", "y_geodetic_m", "z_geodetic_m")
PHOTO: Final = ("x_photo_m", "y_photo_m", "z_photo_m")
DIFFERENCE: Final = ("dx_cm", "dy_cm", "dz_cm")
DLT_INPUT: Final = ("x_input_m", "y_input_m", "z_input_m")
DLT_POINT: Final = ("x_dlt_m", "y_dlt_m", "z_dlt_m")
SUMS: Final = ("fxx_cm2", "fyy_cm2", "fzz_cm2")
GON: Final = np.pi / 200.0
#: Step of the comparator readings, mm.
GRID_MM: Final = 0.001
#: Number of runs with emulated single precision.
RUNS: Final = 200
#: Largest rounding error, cm, of printed differences of coordinates with four decimals.
ROUNDED_CM: Final = 0.011
#: Row of a table by its name, or a point by its number.
Row = int | str


def _name(row: Row) -> str:
    return row if isinstance(row, str) else f"point {row}"


def points_of(values: Values, table: str, quantities: Sequence[str], points: Sequence[Row] = POINTS) -> Array:
    """Return the printed numbers (n, k) of some points (or other rows) of a table."""
    return np.array([[values[row_key(table, _name(row), q)] for q in quantities] for row in points])


def cells_of(
    table: str,
    quantities: Sequence[str],
    points: Sequence[Row],
    numbers: npt.ArrayLike,
    half: npt.ArrayLike = np.nan,
) -> Cells:
    """Return the cells of some points (or other rows) of a table, with numbers (n, k) and spreads of size ``half``."""
    shape = len(points), len(quantities)
    pairs = np.reshape(numbers, shape), np.broadcast_to(half, shape)
    return {
        row_key(table, _name(row), q): Recomputed.around(pairs[0][i, j], pairs[1][i, j])
        for i, row in enumerate(points)
        for j, q in enumerate(quantities)
    }


def interior(values: Values, photo: str) -> PhotoInterior:
    """Return the interior orientation of a photo as printed."""
    names = ("c", "xo", "zo", "k1", "k2", "k3", "p1", "p2", "ap", "bp")
    c, *others = points_of(values, "ek1.cameras", names, [photo])[0].tolist()
    return PhotoInterior(c, np.array(others[:2]), np.array(others[2:]))


def oriented(values: Values) -> list[Photo]:
    """Return the photos as printed, for refined image coordinates."""
    out = []
    for photo in PHOTOS:
        numbers = points_of(values, "ek1.cameras", ("c", "omega", "phi", "kappa", *STATION), [photo])
        c, omega, phi, kappa, *station = numbers[0].tolist()
        rotation = rotation_from_ayhan(omega * GON, phi * GON, kappa * GON)
        out.append(Photo.of(photo, PhotoInterior(c), rotation, station))
    return out


def _as_program(camera: PhotoInterior, measured: Array) -> Array:
    """Return the refined coordinates of the author's program, which doubles the P2 term of z in its last stage."""
    reduced = np.ascontiguousarray(measured - camera.principal)
    out = ideal_points(camera.corrections, reduced)
    out[:, 1] += camera.corrections[4] * (np.sum(reduced**2, axis=1) + 2.0 * reduced[:, 1] ** 2)
    return out


def comparator(values: Values) -> Array:
    """Return comparator coordinates (49, 4), mm, that give the printed refined ones, rounded to 1 um."""
    out = []
    for photo, refined in zip(PHOTOS, np.hsplit(points_of(values, "ek1.refined", REFINED), 2), strict=True):
        camera = interior(values, photo)
        at = refined + camera.principal
        for _ in range(30):  # corrections change by less than 1 % of a step, so the iteration converges
            at = at + refined - _as_program(camera, at)
        out.append(at)
    return np.asarray(np.round(np.hstack(out) / GRID_MM) * GRID_MM)


def comparator_cells(values: Values) -> Cells:
    """Recompute appendix 1: comparator coordinates that follow from the printed refined coordinates."""
    back = comparator(values)[np.array(CONTROL) - 1]
    return cells_of("ek1.comparator", COMPARATOR, CONTROL, back)


def refined_cells(values: Values) -> Cells:
    """Recompute appendix 1: refined coordinates of control points, within one step of single precision."""
    raw = points_of(values, "ek1.comparator", COMPARATOR, CONTROL)
    sides = zip(PHOTOS, np.hsplit(raw, 2), strict=True)
    out = np.hstack([_as_program(interior(values, photo), side) for photo, side in sides])
    step = np.spacing(raw.astype(np.float32)).astype(float)
    return cells_of("ek1.refined", REFINED, CONTROL, out, step)


def _intersected(photos: Sequence[Photo], image: Array, *, reweighted: bool = False) -> Intersection:
    """Return all points from image coordinates (n, 4) of both photos."""
    n = len(image)
    both = np.concatenate(np.hsplit(image, 2))
    return intersect_photos(photos, np.repeat([0, 1], n), np.tile(np.arange(n), 2), both, reweighted=reweighted)


def _refined_points(values: Values) -> Array:
    """Return all points (49, 3) from the printed refined coordinates."""
    return _intersected(oriented(values), points_of(values, "ek1.refined", REFINED), reweighted=True).points_m


def _single_precision(values: Values) -> Array:
    """Return points (runs, 49, 3) by section 2.5 in single precision; raw numbers are moved by up to half a step."""
    rng, photos, runs = np.random.default_rng(1), oriented(values), []
    refined = np.hsplit(points_of(values, "ek1.refined", REFINED), 2)
    near = points_of(values, "ek1.points", PHOTO)
    for _ in range(RUNS):
        normal, right = np.zeros((N, 3, 3), np.float32), np.zeros((N, 3), np.float32)
        for photo, side in zip(photos, refined, strict=True):
            matrix = _rounded(photo.matrix[:, :3], rng)
            centre, image = _rounded(photo.origin_m, rng), _rounded(side, rng)
            depth = ((near - photo.origin_m) @ photo.matrix[2, :3]).astype(np.float32)
            rows = (image[:, :, None] * matrix[2] - matrix[:2]) / depth[:, None, None]
            normal += np.einsum("nij,nik->njk", rows, rows)
            right += np.einsum("nij,ni->nj", rows, np.einsum("nij,j->ni", rows, centre))
        runs.append(np.linalg.solve(normal, right[:, :, None])[:, :, 0].astype(float))
    return np.array(runs)


def _rounded(numbers: Array, rng: np.random.Generator) -> npt.NDArray[np.float32]:
    """Return single-precision numbers, moved at random by up to half a step: the program's rounding is unknown."""
    step = np.spacing(numbers.astype(np.float32))
    return np.asarray((numbers + rng.uniform(-0.5, 0.5, numbers.shape) * step).astype(np.float32))


def point_cells(values: Values) -> Cells:
    """Recompute appendix 1: intersection of other than control points, and differences from geodetic coordinates."""
    spread = 3.0 * np.std(_single_precision(values), axis=0)
    others = [k for k in POINTS if k not in CONTROL]
    rows = np.array(others) - 1
    out = cells_of("ek1.points", PHOTO, others, _refined_points(values)[rows], spread[rows])
    difference = 100.0 * (points_of(values, "ek1.points", GEODETIC) - points_of(values, "ek1.points", PHOTO))
    return out | cells_of("ek1.points", DIFFERENCE, POINTS, difference, ROUNDED_CM)


def dlt_photos(values: Values, distortion: Sequence[str] = ()) -> list[DltFit]:
    """Return the DLT of both photos from the 15 control points."""
    ground = points_of(values, "ek2.control", DLT_INPUT, CONTROL)
    sides = zip(PHOTOS, np.hsplit(points_of(values, "ek1.comparator", COMPARATOR, CONTROL), 2), strict=True)
    return [fit_dlt(ground, side, distortion=distortion, name=photo) for photo, side in sides]


def dlt_points(values: Values) -> Intersection:
    """Return all points by DLT; control points use their printed comparator coordinates."""
    raw = comparator(values)
    raw[np.array(CONTROL) - 1] = points_of(values, "ek1.comparator", COMPARATOR, CONTROL)
    return _intersected([fit.photo for fit in dlt_photos(values)], raw)


def dlt_parameter_cells(values: Values) -> Cells:
    """Recompute appendix 2: 11 parameters within their printed standard deviations, orientation within our own."""
    out: Cells = {}
    names = [f"L{k}" for k in range(1, 12)]
    for fit, photo in zip(dlt_photos(values), PHOTOS, strict=True):
        matrix = fit.photo.about(np.zeros(3)) * np.array([[1e-3], [1e-3], [1.0]])
        half = points_of(values, "ek2.dlt", [f"{name}_std" for name in names], [photo])
        out |= cells_of("ek2.dlt", names, [photo], (matrix / matrix[2, 3]).ravel()[:11], half)
        r = fit.recovered
        omega, phi, kappa = (angle / GON for angle in ayhan_from_rotation(r.rotation))
        assert r.sigma is not None
        angle = r.sigma["turn_x"] / GON, r.sigma["turn_y"] / GON, r.sigma["turn_z"] / GON
        quantities = ("xo_mm", "zo_mm", "c_mm", "omega_gon", "phi_gon", "kappa_gon")
        # kappa refers there to the x axis (eq. 43), here to the y axis
        numbers = *r.principal, 0.5 * (r.cx + r.cy), -omega, phi, kappa - r.skew / GON
        sigmas = r.sigma["x0"], r.sigma["y0"], r.sigma["cx"], *angle
        out |= cells_of("ek2.dlt", quantities, [photo], numbers, sigmas)
    return out


def dlt_control_cells(values: Values) -> Cells:
    """Recompute appendix 2: control points by DLT within their standard deviation; column RMS from its row."""
    points = dlt_points(values)
    assert points.sigma_m is not None
    at = np.array(CONTROL) - 1
    out = cells_of("ek2.control", DLT_POINT, CONTROL, points.points_m[at], points.sigma_m[at])
    rms = np.linalg.norm(points_of(values, "ek2.control", ("mx_mm", "my_mm", "mz_mm"), CONTROL), axis=1)
    return out | cells_of("ek2.control", ("rms_mm",), CONTROL, rms)


def dlt_point_cells(values: Values) -> Cells:
    """Recompute appendix 2: all points by DLT."""
    points = dlt_points(values)
    assert points.sigma_m is not None
    return cells_of("ek2.points", DLT_POINT, POINTS, points.points_m, points.sigma_m)


def accuracy_cells(values: Values) -> Cells:
    """Recompute table 5: the rows whose raw data are printed."""
    land, adjusted = points_of(values, "ek1.points", GEODETIC), points_of(values, "ek1.points", PHOTO)
    control = np.isin(POINTS, CONTROL)[:, None]

    def sums(points: Array) -> Array:
        """Return the sums [Fxx], [Fyy], [Fzz], cm^2."""
        return np.array(compare_points(land, points, np.zeros(len(land), bool)).every.sums_cm2[:3])

    runs = np.array([sums(np.where(control, adjusted, run)) for run in _single_precision(values)])
    ours, half = sums(np.where(control, adjusted, _refined_points(values))), 3.0 * np.std(runs, axis=0)
    return (
        cells_of("5", SUMS, ["collinearity 15"], ours, half)
        | cells_of("5", SUMS, ["dlt 15"], sums(dlt_points(values).points_m))
        | cells_of("5", SUMS, ["parallax"], sums(parallax_points(values)))
    )


def parallax_points(values: Values) -> Array:
    """Return all points by the parallax equations for unequal principal distances."""
    cameras, photos = [interior(values, photo) for photo in PHOTOS], oriented(values)
    sides = [raw - camera.principal for raw, camera in zip(np.hsplit(comparator(values), 2), cameras, strict=True)]
    base = float(np.linalg.norm(photos[1].origin_m - photos[0].origin_m))
    return normal_case(sides[0], sides[1], base, cameras[0].focal, cameras[1].focal, photos[0].origin_m)


# --- appendix 1: the bundle -----------------------------------------------------------------------

UNKNOWN: Final = ("x0", "y0", "c", "k1", "k2", "k3", "p1", "p2", "affinity_a", "affinity_b")
#: Printed names, in the order of our numbers of a photo.
PRINTED: Final = ("xo", "zo", "c", "k1", "k2", "k3", "p1", "p2", "ap", "bp", "omega", "phi", "kappa", "x0", "y0", "z0")
STATION: Final = ("x0", "y0", "z0")
#: Inferred sigmas, in units of m0, of a condition (mm m) and of every observed quantity (m, mm, rad); base, m.
SIGMA_CONDITION: Final = 100.0
SIGMA_OBSERVED: Final = 10.0
BASE_M: Final = 1.199
#: Approximate principal point, mm: middle of the comparator's field; the printed solution starts from whole
#: millimetres.
MIDDLE: Final = (115.0, 143.0)
#: Largest relative difference between a mean error and its print for the verdict ``fitted``.
RATIO: Final = 0.05


def bundle(values: Values, *, backend: str = "dense", with_base: bool = True) -> BundleResult:
    """Adjust the bundle with the inferred weights; sigmas are in units of the printed m0.

    Parameters
    ----------
    values : mapping
        Printed numbers.
    backend : str
    with_base : bool
        True to hold the base fixed. The printed mean errors come from normal equations without this condition.
    """
    m0 = values[row_key("ek1.bundle", "adjustment", "m0")]
    observed, photos = SIGMA_OBSERVED * m0, []
    for photo in PHOTOS:
        c = values[row_key("ek1.bundle", photo, "c_observed")]
        station = points_of(values, "ek1.cameras", STATION, [photo])[0]
        photos.append(
            BundlePhoto(
                photo,
                PhotoInterior(c, np.array(MIDDLE)),
                rotation_from_ayhan(0.0, 0.0, 0.0),
                station,
                UNKNOWN,
                observed={"c": (c, observed)},
                sigma_centre_m=np.full(3, observed),
                sigma_turn_rad=np.full(3, observed),
            )
        )
    land = points_of(values, "ek2.control", DLT_INPUT, CONTROL)
    raw, n = points_of(values, "ek1.comparator", COMPARATOR, CONTROL), len(CONTROL)
    ids = [str(k) for k in CONTROL]
    return adjust_bundle(
        photos,
        ids,
        land,
        np.repeat([0, 1], n),
        np.tile(np.arange(n), 2),
        np.concatenate(np.hsplit(raw, 2)),
        sigma=SIGMA_CONDITION * m0,
        control={name: (at, observed) for name, at in zip(ids, land, strict=True)},
        constraints=[Constraint("base", PHOTOS, BASE_M)] if with_base else [],
        residual="condition",
        backend=backend,
    )


def parameters(result: BundleResult, photo: int) -> dict[str, tuple[float, float]]:
    """Return the numbers of a photo by printed name, angles in gon: value and root of its cofactor."""
    one = result.photos[photo]
    values = one.values.tolist()
    values[10:13] = (a / GON for a in ayhan_from_rotation(result.rotations[photo]))
    return dict(zip(PRINTED, zip(values, np.sqrt(one.cofactors).tolist(), strict=True), strict=True))


def point_roots(result: BundleResult) -> Array:
    """Return the roots of the cofactors (15, 3) of the control points."""
    rows = [result.labels.index(f"point {k} X") for k in CONTROL]
    return np.asarray(np.sqrt([result.cofactors[k : k + 3] for k in rows]))


def camera_cells(values: Values) -> Cells:
    """Recompute appendix 1: adjusted cameras, within their printed mean errors."""
    adjusted = bundle(values)
    numbers = np.array([[value for value, _ in parameters(adjusted, k).values()] for k in range(len(PHOTOS))])
    half = points_of(values, "ek1.bundle", [f"m_{name}" for name in PRINTED], PHOTOS)
    half[:, 10:13] /= GON
    out = cells_of("ek1.cameras", PRINTED, PHOTOS, numbers, half)
    for key in (row_key("ek1.cameras", photo, name) for photo in PHOTOS for name in STATION):
        out[key] = Recomputed(out[key].value, kind="not_reproducible")
    return out


def bundle_cells(values: Values) -> Cells:
    """Recompute appendix 1: 77 mean errors, 15 adjusted control points, and m0."""
    held, free = bundle(values), bundle(values, with_base=False)
    adjusted, errors = (tuple(name.format(axis) for axis in "xyz") for name in ("{}_adjusted_m", "m_{}_m"))
    half = points_of(values, "ek1.bundle", errors, CONTROL)
    out = cells_of("ek1.bundle", adjusted, CONTROL, held.points_m, half)
    roots = np.array([[root for _, root in parameters(free, k).values()] for k in range(len(PHOTOS))])
    for quantities, rows, numbers in (
        ([f"m_{name}" for name in PRINTED], PHOTOS, roots),
        (errors, CONTROL, point_roots(free)),
    ):
        out |= cells_of("ek1.bundle", quantities, rows, numbers, RATIO * numbers)
    assert held.m0 is not None
    key = row_key("ek1.bundle", "adjustment", "m0")
    out[key] = Recomputed(held.m0 * values[key], facts=(held.redundancy,))
    return out
