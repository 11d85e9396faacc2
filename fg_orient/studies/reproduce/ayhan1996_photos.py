"""Appendices 1 and 2 of Ayhan 1996 from their raw data.

Refined image coordinates, intersection, DLT, parallax, and the self-calibrating bundle of 15 control points from its
comparator coordinates. Weights, the base and the observed stations of the bundle are not printed. The weights used here
are inferred from the 77 printed mean errors (1e-4 of a condition in mm m, 1e-2 of everything observed in m, mm and rad,
relative to the printed m0). The observed stations are the listing's own result: agreement is a pattern, not evidence.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from factors._contract import Array
from factors.cameras.image_corrections import ideal_points
from fg_orient.closerange.accuracy import compare_points
from fg_orient.closerange.bundle import BundlePhoto, BundleResult, adjust_bundle
from fg_orient.closerange.constraints import Constraint
from fg_orient.closerange.dlt import DltFit, fit_dlt
from fg_orient.closerange.intersection import Intersection, intersect_photos, normal_case
from fg_orient.closerange.photo import Photo, PhotoInterior, ayhan_from_rotation, rotation_from_ayhan
from fg_orient.model.cells import CellKey
from fg_orient.studies.reproduce.verdict import Cells, Kind, Recomputed, Values

N: Final = 49
POINTS: Final = tuple(range(1, N + 1))
CONTROL: Final = (1, 3, 5, 7, 9, 11, 13, 15, 33, 35, 37, 39, 44, 45, 49)
PHOTOS: Final = ("photo 1", "photo 2")
COMPARATOR: Final = ("x1_mm", "z1_mm", "x2_mm", "z2_mm")
REFINED: Final = ("xs1_mm", "zs1_mm", "xs2_mm", "zs2_mm")
GEODETIC: Final = ("x_geodetic_m", "y_geodetic_m", "z_geodetic_m")
PHOTO: Final = ("x_photo_m", "y_photo_m", "z_photo_m")
DLT_POINT: Final = ("x_dlt_m", "y_dlt_m", "z_dlt_m")
SUMS: Final = ("fxx_cm2", "fyy_cm2", "fzz_cm2")
GON: Final = np.pi / 200.0
#: Grid of the comparator, mm.
GRID_MM: Final = 0.001
#: Runs of the emulated single precision.
RUNS: Final = 200
#: Cells by their largest printed rounding, of coordinates with four decimals in differences, cm.
ROUNDED_CM: Final = 0.011
SINGLE: Final = f"three standard deviations of {RUNS} runs in single precision (the program's is not known)"


def points_of(values: Values, table: str, quantities: Sequence[str], points: Sequence[int] = POINTS) -> Array:
    """Printed numbers (n, k) of some points of a table."""
    return np.array([
        [values[CellKey(table, quantity=q, parameter=f"point {k}")] for q in quantities] for k in points
    ])  # fmt: skip


def cells_of(
    table: str, quantities: Sequence[str], points: Sequence[int], numbers: Array, remark: str,
    half: npt.ArrayLike = np.nan,
) -> Cells:  # fmt: skip
    """Cells of a table of points from numbers (n, k) with spreads of a size ``half``."""
    numbers = numbers.reshape(len(points), -1)
    halves = np.broadcast_to(half, numbers.shape)
    return {
        CellKey(table, quantity=q, parameter=f"point {k}"): Recomputed.around(numbers[i, j], halves[i, j], remark)
        for i, k in enumerate(points)
        for j, q in enumerate(quantities)
    }


def _camera(values: Values, photo: str) -> dict[str, float]:
    return {key.quantity: v for key, v in values.items() if key.table == "ek1.cameras" and key.parameter == photo}


def interior(values: Values, photo: str) -> PhotoInterior:
    """Interior orientation of a photo as printed."""
    c = _camera(values, photo)
    names = ("k1", "k2", "k3", "p1", "p2", "ap", "bp")
    return PhotoInterior(c["c"], np.array([c["xo"], c["zo"]]), np.array([c[name] for name in names]))


def oriented(values: Values) -> list[Photo]:
    """Photos as printed, for refined image coordinates."""
    out = []
    for photo in PHOTOS:
        c = _camera(values, photo)
        rotation = rotation_from_ayhan(c["omega"] * GON, c["phi"] * GON, c["kappa"] * GON)
        out.append(Photo.of(photo, PhotoInterior(c["c"]), rotation, [c["x0"], c["y0"], c["z0"]]))
    return out


def _as_program(camera: PhotoInterior, measured: Array) -> Array:
    """Refined coordinates of the thesis' program: it doubles the P2 term of z in its last stage."""
    reduced = np.ascontiguousarray(measured - camera.principal)
    out = ideal_points(camera.corrections, reduced)
    out[:, 1] += camera.corrections[4] * (np.sum(reduced**2, axis=1) + 2.0 * reduced[:, 1] ** 2)
    return out


def comparator(values: Values) -> Array:
    """Comparator coordinates (49, 4), mm: printed refined ones taken back and put on the grid of 1 um."""
    refined, out = points_of(values, "ek1.refined", REFINED), np.empty((N, 4))
    for k, photo in enumerate(PHOTOS):
        camera, wanted = interior(values, photo), refined[:, 2 * k : 2 * k + 2]
        at = wanted + camera.principal
        for _ in range(30):  # corrections change by less than 1 % of a step: a fixed point
            at = at + wanted - _as_program(camera, at)
        out[:, 2 * k : 2 * k + 2] = at
    return np.asarray(np.round(out / GRID_MM) * GRID_MM)


def comparator_cells(values: Values) -> Cells:
    """Appendix 1: comparator coordinates that follow from the printed refined ones."""
    back = comparator(values)[np.array(CONTROL) - 1]
    remark = "the refined coordinates taken back to the grid of 1 um"
    return cells_of("ek1.comparator", COMPARATOR, CONTROL, back, remark)


def refined_cells(values: Values) -> Cells:
    """Appendix 1: refined coordinates of the control points, within one step of single precision of the raw ones."""
    raw, out = points_of(values, "ek1.comparator", COMPARATOR, CONTROL), np.empty((len(CONTROL), 4))
    for k, photo in enumerate(PHOTOS):
        out[:, 2 * k : 2 * k + 2] = _as_program(interior(values, photo), raw[:, 2 * k : 2 * k + 2])
    step = np.spacing(raw.astype(np.float32)).astype(float)
    remark = "the P2 term of z doubled, as the program does; spread: one step of single precision of the raw coordinate"
    return cells_of("ek1.refined", REFINED, CONTROL, out, remark, step)


def _intersected(photos: Sequence[Photo], image: Array, *, reweighted: bool = False) -> Intersection:
    """All points from image coordinates (n, 4) of both photos."""
    n = len(image)
    both = np.concatenate([image[:, :2], image[:, 2:]])
    return intersect_photos(photos, np.repeat([0, 1], n), np.tile(np.arange(n), 2), both, reweighted=reweighted)


def _single_precision(values: Values) -> Array:
    """Points (runs, 49, 3) of the equations of section 2.5 in single precision, raw numbers moved by half a step."""
    rng, photos = np.random.default_rng(1), oriented(values)
    refined, runs = points_of(values, "ek1.refined", REFINED), []
    near = points_of(values, "ek1.points", PHOTO)
    for _ in range(RUNS):
        normal, right = np.zeros((N, 3, 3), np.float32), np.zeros((N, 3), np.float32)
        for k, photo in enumerate(photos):
            matrix = _rounded(photo.matrix[:, :3], rng)
            centre, image = _rounded(photo.origin_m, rng), _rounded(refined[:, 2 * k : 2 * k + 2], rng)
            depth = ((near - photo.origin_m) @ photo.matrix[2, :3]).astype(np.float32)
            rows = (image[:, :, None] * matrix[2] - matrix[:2]) / depth[:, None, None]
            normal += np.einsum("nij,nik->njk", rows, rows)
            right += np.einsum("nij,ni->nj", rows, np.einsum("nij,j->ni", rows, centre))
        runs.append(np.linalg.solve(normal, right[:, :, None])[:, :, 0].astype(float))
    return np.array(runs)


def _rounded(numbers: Array, rng: np.random.Generator) -> npt.NDArray[np.float32]:
    """Single precision of numbers, moved by up to half a step: which way a program rounds is chance."""
    step = np.spacing(numbers.astype(np.float32))
    return np.asarray((numbers + rng.uniform(-0.5, 0.5, numbers.shape) * step).astype(np.float32))


def point_cells(values: Values) -> Cells:
    """Appendix 1: intersection of the points that are no control points, and differences from the geodetic ones."""
    ours = _intersected(oriented(values), points_of(values, "ek1.refined", REFINED), reweighted=True).points_m
    spread = 3.0 * np.std(_single_precision(values), axis=0)
    others = [k for k in POINTS if k not in CONTROL]
    rows = np.array(others) - 1
    difference = 100.0 * (points_of(values, "ek1.points", GEODETIC) - points_of(values, "ek1.points", PHOTO))
    remark = "the coordinates beside it, which have four decimals"
    return cells_of("ek1.points", PHOTO, others, ours[rows], SINGLE, spread[rows]) | cells_of(
        "ek1.points", ("dx_cm", "dy_cm", "dz_cm"), POINTS, difference, remark, ROUNDED_CM
    )


def dlt_photos(values: Values, distortion: Sequence[str] = ()) -> list[DltFit]:
    """DLT of both photos from the 15 control points."""
    ground = points_of(values, "ek2.control", ("x_input_m", "y_input_m", "z_input_m"), CONTROL)
    raw = points_of(values, "ek1.comparator", COMPARATOR, CONTROL)
    return [fit_dlt(ground, raw[:, 2 * k : 2 * k + 2], distortion=distortion, name=p) for k, p in enumerate(PHOTOS)]


def dlt_points(values: Values) -> Intersection:
    """All points by DLT; the control points from their printed comparator coordinates."""
    raw = comparator(values)
    raw[np.array(CONTROL) - 1] = points_of(values, "ek1.comparator", COMPARATOR, CONTROL)
    return _intersected([fit.photo for fit in dlt_photos(values)], raw)


def dlt_parameter_cells(values: Values) -> Cells:
    """Appendix 2: 11 parameters within the printed standard deviation of theirs, orientation within ours."""
    out: Cells = {}
    for fit, photo in zip(dlt_photos(values), PHOTOS, strict=True):
        matrix = fit.photo.about(np.zeros(3)) * np.array([[1e-3], [1e-3], [1.0]])
        ours = (matrix / matrix[2, 3]).ravel()[:11]
        for k, value in enumerate(ours.tolist(), start=1):
            key = CellKey("ek2.dlt", quantity=f"L{k}", parameter=photo)
            half = values[key._replace(quantity=f"L{k}_std")]
            remark = "spread: the printed standard deviation; 11 parameters here, 16 there"
            if k in (4, 8):
                remark = "ten times the printed number: with that the projection gives 0.032 m for 0.124 m"
            out[key] = Recomputed.around(value, half, remark)
        r = fit.recovered
        omega, phi, kappa = (angle / GON for angle in ayhan_from_rotation(r.rotation))
        assert r.sigma is not None
        angle = r.sigma["turn_x"] / GON, r.sigma["turn_y"] / GON, r.sigma["turn_z"] / GON
        size = np.array([r.sigma["x0"], r.sigma["y0"], r.sigma["cx"], *angle])
        # kappa there is that of the x axis (eq. 43), here that of the y axis
        numbers = (*r.principal, 0.5 * (r.cx + r.cy), -omega, phi, kappa - r.skew / GON)
        names = ("xo_mm", "zo_mm", "c_mm", "omega_gon", "phi_gon", "kappa_gon")
        for name, v, s in zip(names, numbers, size, strict=True):
            remark = "spread: our standard deviation" + ("; of the other sense of rotation" if name[0] == "o" else "")
            out[CellKey("ek2.dlt", quantity=name, parameter=photo)] = Recomputed.around(v, s, remark)
    return out


def dlt_control_cells(values: Values) -> Cells:
    """Appendix 2: control points by DLT within their standard deviation; the column RMS follows from its row."""
    found = dlt_points(values)
    assert found.sigma_m is not None
    at = np.array(CONTROL) - 1
    remark = "spread: one standard deviation of the point; 11 parameters here, 16 there"
    out = cells_of("ek2.control", DLT_POINT, CONTROL, found.points_m[at], remark, found.sigma_m[at])
    rms = np.linalg.norm(points_of(values, "ek2.control", ("mx_mm", "my_mm", "mz_mm"), CONTROL), axis=1)
    return out | cells_of("ek2.control", ("rms_mm",), CONTROL, rms, "root of the sum of the squares beside it")


def dlt_point_cells(values: Values) -> Cells:
    """Appendix 2: all points by DLT."""
    found = dlt_points(values)
    assert found.sigma_m is not None
    remark = (
        "spread: one standard deviation of the point; this list and that of the control points differ for points "
        "9, 11, 13 and 15, so its image coordinates were probably others"
    )
    return cells_of("ek2.points", DLT_POINT, POINTS, found.points_m, remark, found.sigma_m)


def accuracy_cells(values: Values) -> Cells:
    """Table 5: the rows whose raw data are printed."""
    land = points_of(values, "ek1.points", GEODETIC)
    control = np.isin(POINTS, CONTROL)
    adjusted = points_of(values, "ek1.points", PHOTO)
    ours = _intersected(oriented(values), points_of(values, "ek1.refined", REFINED), reweighted=True).points_m
    runs = np.array([_sums(land, np.where(control[:, None], adjusted, run)) for run in _single_precision(values)])
    value, half = _sums(land, np.where(control[:, None], adjusted, ours)), 3.0 * np.std(runs, axis=0)
    remark = f"our intersection, control points as printed; appendix 1 itself has four decimals; spread: {SINGLE}"
    out: Cells = {}
    for k, quantity in enumerate(SUMS):
        out[CellKey("5", quantity=quantity, parameter="collinearity 15")] = Recomputed.around(value[k], half[k], remark)
    for row, points, why in (
        ("dlt 15", dlt_points(values).points_m, "our DLT; appendix 2 itself gives 0.36-0.46, 4.3-4.5, 1.43-1.52"),
        ("parallax", parallax_points(values), "principal points of the bundle; the fiducial ones are not printed, and "
         "the convergence is ignored"),
    ):  # fmt: skip
        for quantity, sum_ in zip(SUMS, _sums(land, points), strict=True):
            out[CellKey("5", quantity=quantity, parameter=row)] = Recomputed(float(sum_), why)
    return out


def _sums(land: Array, points: Array) -> Array:
    """[Fxx], [Fyy], [Fzz], cm^2."""
    return np.array(compare_points(land, points, np.zeros(len(land), bool)).every.sums_cm2[:3])


def parallax_points(values: Values) -> Array:
    """All points by the parallax equations of unequal principal distances."""
    raw, cameras = comparator(values), [interior(values, photo) for photo in PHOTOS]
    sides = [raw[:, 2 * k : 2 * k + 2] - cameras[k].principal for k in (0, 1)]
    photos = oriented(values)
    base = float(np.linalg.norm(photos[1].origin_m - photos[0].origin_m))
    return normal_case(sides[0], sides[1], base, cameras[0].focal, cameras[1].focal, photos[0].origin_m)


# --- appendix 1: the bundle -----------------------------------------------------------------------

UNKNOWN: Final = ("x0", "y0", "c", "k1", "k2", "k3", "p1", "p2", "affinity_a", "affinity_b")
#: Names of the print, in the order of our numbers of a photo.
PRINTED: Final = ("xo", "zo", "c", "k1", "k2", "k3", "p1", "p2", "ap", "bp", "omega", "phi", "kappa", "x0", "y0", "z0")
STATION: Final = ("x0", "y0", "z0")
#: Inferred: sigma of a condition (mm m) and of everything observed (m, mm, rad), in units of m0; base, m.
SIGMA_CONDITION: Final = 100.0
SIGMA_OBSERVED: Final = 10.0
BASE_M: Final = 1.199
#: Start of the principal point, mm: the middle of the comparator's field; the print starts from whole millimetres.
MIDDLE: Final = (115.0, 143.0)
#: Ratio of a mean error to its print that is still called the same pattern.
RATIO: Final = 0.05
INFERRED: Final = "weights inferred from this listing"
OWN: Final = "observed as the listing's own result: agreement would say nothing"


def bundle(values: Values, *, backend: str = "dense", with_base: bool = True) -> BundleResult:
    """The bundle under the inferred weights; sigmas in units of the printed m0.

    Parameters
    ----------
    values : mapping
        Printed numbers.
    backend : str
    with_base : bool
        Hold the base. The printed mean errors are those of the normal equations without that condition.
    """
    observed, photos = SIGMA_OBSERVED * _m0(values), []
    for photo in PHOTOS:
        c = values[CellKey("ek1.bundle", quantity="c_observed", parameter=photo)]
        station = [values[CellKey("ek1.cameras", quantity=q, parameter=photo)] for q in STATION]
        photos.append(BundlePhoto(
            photo, PhotoInterior(c, np.array(MIDDLE)), rotation_from_ayhan(0.0, 0.0, 0.0), np.array(station), UNKNOWN,
            observed={"c": (c, observed)}, sigma_centre_m=np.full(3, observed), sigma_turn_rad=np.full(3, observed),
        ))  # fmt: skip
    land = points_of(values, "ek2.control", ("x_input_m", "y_input_m", "z_input_m"), CONTROL)
    raw, n = points_of(values, "ek1.comparator", COMPARATOR, CONTROL), len(CONTROL)
    ids = [str(k) for k in CONTROL]
    return adjust_bundle(
        photos, ids, land, np.repeat([0, 1], n), np.tile(np.arange(n), 2), np.concatenate([raw[:, :2], raw[:, 2:]]),
        sigma=SIGMA_CONDITION * _m0(values), control={name: (at, observed) for name, at in zip(ids, land, strict=True)},
        constraints=[Constraint("base", PHOTOS, BASE_M)] if with_base else [], residual="condition", backend=backend,
    )  # fmt: skip


def _m0(values: Values) -> float:
    return values[CellKey("ek1.bundle", quantity="m0", parameter="adjustment")]


def parameters(found: BundleResult, photo: int) -> dict[str, tuple[float, float]]:
    """Numbers of a photo by the names of the print, angles in gon: value and root of its cofactor."""
    one = found.photos[photo]
    values = dict(zip(PRINTED, one.values.tolist(), strict=True))
    values |= dict(zip(PRINTED[10:13], (a / GON for a in ayhan_from_rotation(found.rotations[photo])), strict=True))
    return {name: (values[name], float(q)) for name, q in zip(PRINTED, np.sqrt(one.cofactors), strict=True)}


def point_roots(found: BundleResult) -> Array:
    """Roots of the cofactors (15, 3) of the control points."""
    rows = [found.labels.index(f"point {k} X") for k in CONTROL]
    return np.asarray(np.sqrt([found.cofactors[k : k + 3] for k in rows]))


def _near(printed: float, value: float, half: float, remark: str) -> Recomputed:
    kind: Kind = "pattern" if abs(value - printed) <= half else "differs"
    return Recomputed.around(value, half, f"{INFERRED}; {remark}", kind)


def camera_cells(values: Values) -> Cells:
    """Appendix 1: adjusted cameras, within a printed mean error."""
    found, out = bundle(values), Cells()
    for k, photo in enumerate(PHOTOS):
        for name, (value, _) in parameters(found, k).items():
            key = CellKey("ek1.cameras", quantity=name, parameter=photo)
            error = values[CellKey("ek1.bundle", quantity=f"m_{name}", parameter=photo)]
            half = error / GON if name in PRINTED[10:13] else error
            out[key] = (Recomputed(value, OWN, kind="not_reproducible") if name in STATION
                        else _near(values[key], value, half, "spread: the printed mean error"))  # fmt: skip
    return out


def bundle_cells(values: Values) -> Cells:
    """Appendix 1: 77 mean errors, 15 adjusted control points, m0."""
    held, free = bundle(values), bundle(values, with_base=False)
    errors = {
        CellKey("ek1.bundle", quantity=f"m_{name}", parameter=photo): root
        for k, photo in enumerate(PHOTOS) for name, (_, root) in parameters(free, k).items()
    }  # fmt: skip
    out: Cells = {}
    for i, (k, roots) in enumerate(zip(CONTROL, point_roots(free), strict=True)):
        for j, axis in enumerate("xyz"):
            mean = CellKey("ek1.bundle", quantity=f"m_{axis}_m", parameter=f"point {k}")
            errors[mean] = float(roots[j])
            key = mean._replace(quantity=f"{axis}_adjusted_m")
            out[key] = _near(values[key], float(held.points_m[i, j]), values[mean], "spread: the printed mean error")
    for key, root in errors.items():
        out[key] = _near(values[key], root, RATIO * root, f"with the printed m0, without the base; spread: {RATIO:.0%}")
    assert held.m0 is not None
    remark = f"{INFERRED}; redundancy {held.redundancy} here, the print implies 39, the text 37 or 43"
    out[CellKey("ek1.bundle", quantity="m0", parameter="adjustment")] = Recomputed(held.m0 * _m0(values), remark)
    return out
