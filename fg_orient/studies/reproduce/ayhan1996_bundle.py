"""Appendix 1 of Ayhan 1996: the self-calibrating bundle of 15 control points from its comparator coordinates.

Weights, the base and the observed stations are not printed. The weights used here are inferred from the 77 printed mean
errors themselves (1e-4 of a condition in mm m, 1e-2 of everything observed in m, mm and rad, relative to the printed
m0), and the observed stations are the listing's own result: agreement is a pattern, not evidence.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.closerange.bundle import BundlePhoto, BundleResult, adjust_bundle
from fg_orient.closerange.constraints import Constraint
from fg_orient.closerange.photo import PhotoInterior, ayhan_from_rotation, rotation_from_ayhan
from fg_orient.model.cells import CellKey
from fg_orient.studies.reproduce.ayhan1996_photos import COMPARATOR, CONTROL, GON, PHOTOS, points_of
from fg_orient.studies.reproduce.found import Found
from fg_orient.studies.reproduce.verdict import Kind

Array = npt.NDArray[np.float64]
Values = Mapping[CellKey, float]
Cells = dict[CellKey, Found]

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


def _near(printed: float, value: float, half: float, remark: str) -> Found:
    kind: Kind = "pattern" if abs(value - printed) <= half else "differs"
    return Found(value, f"{INFERRED}; {remark}", value - half, value + half, kind=kind)


def camera_cells(values: Values) -> Cells:
    """Appendix 1: adjusted cameras, within a printed mean error."""
    found, out = bundle(values), Cells()
    for k, photo in enumerate(PHOTOS):
        for name, (value, _) in parameters(found, k).items():
            key = CellKey("ek1.cameras", quantity=name, parameter=photo)
            error = values[CellKey("ek1.bundle", quantity=f"m_{name}", parameter=photo)]
            half = error / GON if name in PRINTED[10:13] else error
            out[key] = (Found(value, OWN, kind="not_reproducible") if name in STATION
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
    out[CellKey("ek1.bundle", quantity="m0", parameter="adjustment")] = Found(held.m0 * _m0(values), remark)
    return out


COMPUTERS: Final[dict[str, Callable[[Values], Cells]]] = {"ek1.cameras": camera_cells, "ek1.bundle": bundle_cells}
