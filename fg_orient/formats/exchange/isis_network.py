"""Control networks of ISIS in text form (PVL), as the program ``cnetbin2pvl`` writes them.

Points have body-fixed coordinates in metres. The serial numbers of the images are their
names. Points have three types:

- free points are tie points with start values;
- constrained points are control points; their standard deviations along longitude, latitude and radius come from the
  a priori covariance matrix;
- fixed points are control points without uncertainty.

Ignored points and measures, candidates, and measures that jigsaw rejected are left out
and counted. Samples and lines are 1 at the centre of the first pixel.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from factors.arrays import Array
from fg_orient.formats.atomic import write_lines
from fg_orient.formats.exchange.survey import UNKNOWN, Gathering, Survey
from fg_orient.formats.exchange.text import digits
from fg_orient.formats.pvl import Pvl, read_pvl
from fg_orient.formats.registry import POINTS_AND_MARKS, Format, Holds, Settings
from fg_orient.geodesy import BODY_FIXED, enu_from_ecef
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.model.names import Role

#: For each type of a point: its role, and whether it is fixed. The last three types occur in older networks.
TYPES: Final = {
    "free": (Role.TIE, False), "constrained": (Role.CONTROL, False), "fixed": (Role.CONTROL, True),
    "tie": (Role.TIE, False), "ground": (Role.CONTROL, True), "equivalent": (Role.TIE, False),
}  # fmt: skip
#: Larger correlations between East, North and Up are counted as lost.
CORRELATED: Final = 1e-6


def read_isis(paths: tuple[Path, ...], settings: Settings) -> Survey:
    """Read a network; its coordinates are always body-fixed, for any settings."""
    path = paths[0]
    if settings.crs not in ("", BODY_FIXED):
        raise InputError.of("isis.crs", file=path, option="crs", value=settings.crs)
    networks = [*read_pvl(path).every("ControlNetwork")]
    if not networks:
        raise InputError.of("isis.no_network", file=path)
    gathered = Gathering(path, "", BODY_FIXED)
    left, correlated = Counter[str](), 0
    for point in networks[0].every("ControlPoint"):
        try:
            if point.is_true("Ignore"):
                left["ignored points"] += 1
                continue
            role, fixed = _type(point)
            place, sigma = _place(point, role, fixed), UNKNOWN
            if role is Role.CONTROL and not fixed:
                sigma, is_correlated = _sigmas(point, place)
                correlated += is_correlated
            name = point.text("PointId")
            gathered.point(name, role, UNKNOWN if role is Role.TIE else place, sigma, line=point.line, fixed=fixed)
            if role is Role.TIE and np.isfinite(place).all():
                gathered.start(name, place)
            for one in point.every("ControlMeasure"):
                reason = _left_out(one)
                if reason:
                    left[reason] += 1
                    continue
                line, sample = one.number("Line") - 1.0, one.number("Sample") - 1.0
                gathered.measure(one.text("SerialNumber"), name, line, sample, line=one.line)
        except InputError as error:
            gathered.faults.take(*error.problems)
    notes: list[Finding] = [
        finding("isis.left_out", file=path, value=f"{count} {what}") for what, count in sorted(left.items())
    ]
    if correlated:
        notes.append(finding("isis.correlated", file=path, value=f"{correlated} points"))
    gathered.notes = (*gathered.notes, *notes)
    return gathered.finished()


def _type(point: Pvl) -> tuple[Role, bool]:
    """Return the role of a point, and whether it is fixed."""
    kind = point.text("PointType")
    if kind.lower() not in TYPES:
        line = point.values["pointtype"][1]
        raise InputError.of("isis.type", file=point.file, place=f"line {line}", value=kind, known=", ".join(TYPES))
    return TYPES[kind.lower()]


def _place(point: Pvl, role: Role, fixed: bool) -> tuple[float, float, float]:
    """Return the a priori coordinates of a point; they are nan if a tie point has none."""
    if role is Role.TIE and not point.has("AprioriX"):
        return UNKNOWN
    x, y, z = (point.number(f"Apriori{axis}") for axis in "XYZ")
    if fixed and point.has("AdjustedX"):
        x, y, z = (point.number(f"Adjusted{axis}") for axis in "XYZ")
    return x, y, z


def _sigmas(point: Pvl, place: Sequence[float]) -> tuple[tuple[float, float, float], bool]:
    """Return the a priori standard deviations East, North, Up, and whether they are correlated."""
    xx, xy, xz, yy, yz, zz = point.numbers("AprioriCovarianceMatrix", 6)
    own = _axes(place)
    covariance = own @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ own.T
    variances = np.diag(covariance)
    if not (variances > 0.0).all():
        line = point.values["aprioricovariancematrix"][1]
        raise InputError.of("isis.covariance", file=point.file, place=f"line {line}", value=f"{variances.min():.3g} m2")
    east, north, up = np.sqrt(variances).tolist()
    mixed = np.abs(covariance / np.sqrt(np.outer(variances, variances)) - np.eye(3)).max()
    return (east, north, up), bool(mixed > CORRELATED)


def _axes(place: Sequence[float]) -> Array:
    """Return the unit vectors East, North, Up (3, 3) at a point on a sphere."""
    x, y, z = place
    return np.asarray(enu_from_ecef(np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, np.hypot(x, y))))[0])


def _left_out(measure: Pvl) -> str:
    """Return the reason why a measure is left out; "" if it is used."""
    if measure.is_true("Ignore"):
        return "ignored measures"
    if measure.is_true("JigsawRejected"):
        return "measures that jigsaw rejected"
    return "candidate measures" if measure.text("MeasureType", "").lower() == "candidate" else ""


def write_isis(survey: Survey, paths: tuple[Path, ...], settings: Settings) -> tuple[Finding, ...]:
    """Write a network of body-fixed points.

    Tie points without coordinates get no a priori coordinates.
    """
    if survey.crs not in (BODY_FIXED, ""):
        raise InputError.of("isis.crs", file=paths[0], option="to_crs", value=survey.crs)
    o, out = survey.observed, ["Object = ControlNetwork", "  NetworkId = fg_orient", "  Version = 5"]
    rows: dict[int, list[int]] = {}
    for k, point in enumerate(o.point.tolist()):
        rows.setdefault(point, []).append(k)
    for j, name in enumerate(survey.ids):
        known, sigma = bool(survey.located[j]), survey.sigma_enu_m[j]
        kind = "Free" if survey.roles[j] is Role.TIE else "Fixed" if survey.fixed[j] else "Constrained"
        out += ["  Object = ControlPoint", f"    PointType = {kind}", f'    PointId = "{name}"']
        if known:
            place = survey.coordinates[j].tolist()
            out += [f"    Apriori{axis} = {digits(v)} <meters>" for axis, v in zip("XYZ", place, strict=True)]
            if kind == "Constrained":
                own = _axes(place)
                c = own.T @ np.diag(sigma**2) @ own
                numbers = ", ".join(digits(float(v)) for v in (c[0, 0], c[0, 1], c[0, 2], c[1, 1], c[1, 2], c[2, 2]))
                out += [f"    AprioriCovarianceMatrix = ({numbers})"]
                out += [f"    {axis}Constrained = True" for axis in ("Latitude", "Longitude", "Radius")]
        for k in rows.get(j, []):
            out += [
                "    Group = ControlMeasure", f'      SerialNumber = "{survey.images[o.image[k]]}"',
                "      MeasureType = Manual", f"      Sample = {digits(float(o.sample[k]) + 1.0)}",
                f"      Line = {digits(float(o.line[k]) + 1.0)}", "    End_Group",
            ]  # fmt: skip
        out.append("  End_Object")
    write_lines(paths[0], [*out, "End_Object", "End"])
    return ()


ISIS = Format(
    name="isis-network",
    title="ISIS control network (PVL)",
    suffixes=(".pvl", ".net.pvl"),
    first_pixel=(1.0, 1.0),
    pixel_axes="sample, line (pixels)",
    ground_axes="body-fixed x, y, z (m)",
    holds=POINTS_AND_MARKS | {Holds.SIGMA_EAST_NORTH, Holds.FIXED},
    evidence="the network of ISIS's test of jigsaw with Apollo 15 metric images",
    read=read_isis,
    write=write_isis,
    crs=BODY_FIXED,
)
