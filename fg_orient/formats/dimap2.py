"""Reader of DIMAP 2.x sensor products: Pléiades 1A/1B and SPOT 6/7.

Source: docs/equations.md 4 (Terlemezoğlu 2019, eqs. 2.35-2.43 as corrected); conventions
verified on a Pléiades pair against the vendor RPC (0.003 px). Time of a line:
``START + (line - 1) LINE_PERIOD``, lines counted from 1.
Quaternions rotate the vendor's body axes (x along, y across track, z to the Earth) to
ECEF, scalar part ``Q0`` first. Look direction in these axes: ``(YLOS, -XLOS, 1)``; both
are tangents, polynomials of the column minus ``FIRST_COL``. So ``XLOS`` is our
``tan psi_y`` (across) and ``YLOS`` our ``tan psi_x`` (along).
"""

from __future__ import annotations

import math
import re

import numpy as np
import numpy.typing as npt

from factors.geometry.attitude import sign_aligned
from fg_orient.formats import dimap_checks as checks
from fg_orient.formats.dimap_checks import DIMAP_FIRST_PIXEL
from fg_orient.formats.xml import METRES, METRES_PER_SECOND, MILLISECONDS, RADIANS, SECONDS, XmlNode
from fg_orient.model.errors import Finding, finding
from fg_orient.sensors.metadata import (
    Ephemeris,
    FramePoint,
    LineTiming,
    LookAnglePolynomial,
    PushbroomMetadata,
    QuaternionList,
    QuaternionPolynomial,
)

Array = npt.NDArray[np.float64]

#: Profiles this reader knows and the mission they stand for if the file names none.
PROFILES = {"PHR_SENSOR": "PHR", "S6_SENSOR": "SPOT 6", "S7_SENSOR": "SPOT 7"}
MODEL = "Geometric_Data/Refined_Model"
#: Quaternion polynomials are fitted to a scaled time in -1 .. 1; twice that is another day or unit.
MAX_SCALED_TIME = 2.0
#: START .. END and the lines times LINE_PERIOD must agree; a wrong unit is a factor of 1000.
MAX_DURATION_RATIO = 2.0
MAX_DEGREE = 10
_FRAME_TAGS = ("ROW", "COL", "LON", "LAT")


def read_dimap2(root: XmlNode) -> PushbroomMetadata:
    """Read a DIMAP 2.x document of a Pléiades 1A/1B or SPOT 6/7 sensor product.

    Parameters
    ----------
    root : XmlNode
        Root of the document; :func:`fg_orient.formats.dimap.read_dimap` has checked its profile.

    Raises
    ------
    InputError
        A value is missing, malformed or implausible.
    """
    checks.require_pixel_origin(root, "Geoposition/Raster_CS/PIXEL_ORIGIN")
    head = root.one("Metadata_Identification")
    model = root.one(MODEL)
    mission, instrument = _mission(root)
    n_lines, n_samples = checks.image_size(root, "Raster_Data/Raster_Dimensions")
    epoch, timing = _timing(model, n_lines)
    span_s = timing.reference_time_s + timing.line_period_s * np.linspace(0.0, n_lines - 1.0, 5)
    attitude, attitude_notes = _attitude(model.one("Attitudes"), epoch, span_s)
    look, look_notes = _look_angles(model, n_samples)
    frame_points = _frame_points(root)
    return PushbroomMetadata(
        file=root.file,
        mission=mission,
        instrument=instrument,
        format=f"DIMAP {head.one('METADATA_FORMAT').element.get('version')}",
        epoch=epoch,
        n_lines=n_lines,
        n_samples=n_samples,
        timing=timing,
        ephemeris=_ephemeris(model, epoch),
        attitude=attitude,
        look=look,
        frame_points=frame_points,
        notes=attitude_notes + look_notes + _bias_note(model),
        frame_note=finding("image.frame_without_heights") if frame_points else None,
    )


def _mission(root: XmlNode) -> tuple[str, str]:
    """Mission and instrument; a file without Strip_Source is named by its profile."""
    sources = root.maybe("Dataset_Sources")
    nodes = sources.every("Source_Identification", 0) if sources else []
    strips = [strip for node in nodes if (strip := node.maybe("Strip_Source"))]
    if not strips:
        mission = PROFILES[root.one("Metadata_Identification/METADATA_PROFILE").text()]
        return mission, mission
    first = strips[0]
    mission, instrument = (
        f"{first.one(name).text()} {first.one(name + '_INDEX').text()}" for name in ("MISSION", "INSTRUMENT")
    )
    return mission, instrument


def _timing(model: XmlNode, n_lines: int) -> tuple[np.datetime64, LineTiming]:
    limits = model.one("Time/Time_Range")
    epoch, start = limits.one("START").time()
    duration = limits.one("END").seconds_since(epoch) - float(start)
    node = model.one("Time/Time_Stamp/LINE_PERIOD")
    period = node.number(MILLISECONDS, *checks.LINE_PERIOD_S)
    require_duration(node, period, duration, n_lines)
    return epoch, LineTiming(0.0, float(start), period)


def require_duration(node: XmlNode, period_s: float, duration_s: float, n_lines: int) -> None:
    """Refuse a line period (element ``node``) that does not fit the time range of the image."""
    lines = period_s * (n_lines - 1)
    if not lines / MAX_DURATION_RATIO <= duration_s <= lines * MAX_DURATION_RATIO:
        raise node.fault("dimap.duration", f"{lines:.6g} s", duration=duration_s, n_lines=n_lines)


def _ephemeris(model: XmlNode, epoch: np.datetime64) -> Ephemeris:
    points = model.every("Ephemeris/Point_List/Point", checks.MIN_EPHEMERIS_POINTS)
    time_s = checks.times([p.one("TIME") for p in points], epoch)
    position = np.array([p.one("LOCATION_XYZ").vector(3, METRES) for p in points])
    velocity = np.array([p.one("VELOCITY_XYZ").vector(3, METRES_PER_SECOND) for p in points])
    return checks.ephemeris(points, time_s, position, velocity)


# --- attitude --------------------------------------------------------------------------------


def _attitude(
    source: XmlNode, epoch: np.datetime64, span_s: Array
) -> tuple[QuaternionList | QuaternionPolynomial, tuple[Finding, ...]]:
    polynomial = source.maybe("Polynomial_Quaternions")
    if polynomial is None:
        return _quaternion_list(source, epoch)
    notes: tuple[Finding, ...] = ()
    if source.maybe("Quaternion_List"):
        notes = (finding("image.two_attitudes"),)
    return quaternion_polynomial(polynomial, polynomial, span_s), notes


def _quaternion_list(source: XmlNode, epoch: np.datetime64) -> tuple[QuaternionList, tuple[Finding, ...]]:
    """Read sampled quaternions, normalised, signs turned so that neighbours have a positive product."""
    nodes = source.every("Quaternion_List/Quaternion", 2)
    time_s = checks.times([n.one("TIME") for n in nodes], epoch)
    quaternion = np.array([[n.one(f"Q{j}").number() for j in range(4)] for n in nodes])
    checks.require_unit_quaternions(nodes, quaternion)
    flags = [node.maybe("Q_STATUS") for node in nodes]
    count = sum(flag is not None and flag.text() != "NOMINAL" for flag in flags)
    notes = (finding("image.quaternion_flags", count=count, n=len(nodes)),) if count else ()
    return QuaternionList(time_s, sign_aligned(quaternion)), notes


def quaternion_polynomial(node: XmlNode, models: XmlNode, span_s: Array) -> QuaternionPolynomial:
    """Polynomials ``models/Q0`` to ``Q3`` of the time scaled by ``node/OFFSET`` and ``SCALE``.

    ``span_s`` (n,): times of the image at which they must be unit quaternions.

    Raises
    ------
    InputError
        They are made for another time, or are no rotation.
    """
    scale_node = node.one("SCALE")
    offset, scale = node.one("OFFSET").number(SECONDS), scale_node.number(SECONDS, 1e-3, 1e4)
    scaled = (span_s - offset) / scale
    if np.abs(scaled).max() > MAX_SCALED_TIME:
        seen = f"scaled time {scaled[0]:.4g} .. {scaled[-1]:.4g}"
        raise scale_node.fault("dimap.quaternion_span", seen, limit=MAX_SCALED_TIME)
    rows = []
    for j in range(4):
        part = models.one(f"Q{j}")
        rows.append(part.one("COEFFICIENTS").vector(part.one("DEGREE").integer(0, MAX_DEGREE) + 1))
    coefficients = np.zeros((4, max(map(len, rows))))
    for j, row in enumerate(rows):
        coefficients[j, : len(row)] = row
    values = (scaled[:, None] ** np.arange(coefficients.shape[1])) @ coefficients.T
    checks.require_unit_quaternions([node] * len(values), values)
    return QuaternionPolynomial(offset, scale, coefficients)


# --- look angles -----------------------------------------------------------------------------


def _look_angles(model: XmlNode, n_samples: int) -> tuple[LookAnglePolynomial, tuple[Finding, ...]]:
    """Look polynomials of the panchromatic band, of the first band if there is none."""
    calibration = model.one("Geometric_Calibration/Instrument_Calibration")
    if calibration.maybe("Band_Calibration_List") is None:
        return _look_polynomial(calibration, n_samples), ()
    bands = calibration.every("Band_Calibration_List/Band_Calibration")
    names = [band.one("BAND_ID").text() for band in bands]
    chosen = names.index("P") if "P" in names else 0
    look = _look_polynomial(bands[chosen], n_samples)
    others = [_look_polynomial(band, n_samples) for k, band in enumerate(bands) if k != chosen]
    if all(_same(look, other) for other in others):
        return look, ()
    return look, (finding("image.one_band", band=names[chosen]),)


def _same(a: LookAnglePolynomial, b: LookAnglePolynomial) -> bool:
    pairs = ((a.tan_psi_x, b.tan_psi_x), (a.tan_psi_y, b.tan_psi_y))
    return a.origin_sample == b.origin_sample and all(np.array_equal(x, y) for x, y in pairs)


def _look_polynomial(band: XmlNode, n_samples: int) -> LookAnglePolynomial:
    swath = band.one("Swath_Range")
    first = swath.one("FIRST_COL").integer(DIMAP_FIRST_PIXEL, n_samples)
    node = band.one("Polynomial_Look_Angles")
    look = LookAnglePolynomial(
        float(first - DIMAP_FIRST_PIXEL),
        tan_psi_x=_coefficients(node, "YLOS", at_least=1),
        tan_psi_y=_coefficients(node, "XLOS", at_least=2),
    )
    require_look_angles(node, look, n_samples, ("YLOS", "XLOS"))
    return look


def require_look_angles(node: XmlNode, look: LookAnglePolynomial, n_samples: int, names: tuple[str, str]) -> None:
    """Refuse look angles beyond 45 degrees; ``names`` are those of the file for along and across."""
    column = np.array([0.0, (n_samples - 1) / 2, n_samples - 1.0]) - look.origin_sample
    for name, row in zip(names, (look.tan_psi_x, look.tan_psi_y), strict=True):
        tangent = np.polynomial.polynomial.polyval(column, row)
        worst = float(tangent[np.abs(tangent).argmax()])
        if not abs(worst) <= math.tan(checks.MAX_LOOK_ANGLE_RAD):
            raise node.fault("dimap.look_angle", f"{name} = {worst:.6g}")


def _coefficients(node: XmlNode, name: str, at_least: int) -> Array:
    """Coefficients ``name_0``, ``name_1``, ... without gap, constant term first."""
    found = [int(m[1]) for child in node.children() if (m := re.fullmatch(rf"{name}_([0-9]{{1,2}})", child.tag))]
    count = max(at_least, max(found, default=0) + 1)
    return np.array([node.one(f"{name}_{k}").number() for k in range(count)])


# --- the rest --------------------------------------------------------------------------------


def _bias_note(model: XmlNode) -> tuple[Finding, ...]:
    biases = model.maybe("Geometric_Calibration/Instrument_Calibration/Instrument_Biases")
    if biases is None:
        return ()
    angles = [biases.one(name).number(RADIANS) for name in ("YAW", "PITCH", "ROLL")]
    if not any(angles):
        return ()
    return (finding("image.biases", biases_rad=angles),)


def _frame_points(root: XmlNode) -> tuple[FramePoint, ...]:
    extent = root.maybe("Dataset_Content/Dataset_Extent")
    if extent is None:
        return ()
    corners = [(f"corner {k}", v) for k, v in enumerate(extent.every("Vertex", 4), start=1)]
    centre = extent.maybe("Center")
    nodes = corners + ([("centre", centre)] if centre else [])
    return tuple(checks.frame_point(v, id_, _FRAME_TAGS, None) for id_, v in nodes)
