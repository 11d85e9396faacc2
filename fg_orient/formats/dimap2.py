"""Reader of DIMAP 2.x sensor products, Pléiades 1A/1B and SPOT 6/7, and of PHR_DIMAP, the inventory format of CNES.

Source: docs/equations.md 4 (Terlemezoğlu 2019, eqs. 2.35-2.43 as corrected); conventions
verified on a Pléiades pair against the vendor RPC (0.003 px). Time of a line:
``START + (line - 1) LINE_PERIOD``, lines counted from 1.
Quaternions rotate the vendor's body axes (x along, y across track, z to the Earth) to
ECEF, scalar part ``Q0`` first. Look direction in these axes: ``(YLOS, -XLOS, 1)``; both
are tangents, polynomials of the column minus ``FIRST_COL``. So ``XLOS`` is our
``tan psi_y`` (across) and ``YLOS`` our ``tan psi_x`` (along).

PHR_DIMAP holds the same model in other elements: ``Sensor_Model_Characteristics`` has the time of the first line
(``UTC_Sensor_Model_Range/START``), ``SENSOR_LINE_PERIOD`` (ms), state vectors, polynomial quaternions, and the tangents
``PsiX`` (across, the XLOS of DIMAP 2) and ``PsiY`` (along, YLOS). Acquisition lines of other periods
(``PA_LINE_PERIOD``), inertial quaternions and times in TAI do not belong to the image of the product. Verified on a
real file: 0.5 mm from its own RPC, 1 cm from the grid of the physical model.
"""

from __future__ import annotations

import math
import re

import numpy as np
import numpy.typing as npt

from factors.geometry.interpolation import sign_aligned
from fg_orient.formats import dimap_checks as checks
from fg_orient.formats.dimap_checks import DIMAP_FIRST_PIXEL
from fg_orient.formats.xml import METRES, METRES_PER_SECOND, MILLISECONDS, RADIANS, SECONDS, XmlNode
from fg_orient.model.errors import Finding, finding
from fg_orient.sensors.metadata import (
    Ephemeris,
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
PHR_ROOT = "PHR_Dimap_Document"
PHR_MODEL = "Geometric_Data/Sensor_Model_Characteristics"
#: Processing level of the products of PHR_DIMAP that can be read.
PHR_LEVEL = "SENSOR"


def read_dimap2(root: XmlNode) -> PushbroomMetadata:
    """Read a DIMAP 2.x document of a Pléiades 1A/1B or SPOT 6/7 sensor product.

    Parameters
    ----------
    root : XmlNode
        Root of the document; :func:`fg_orient.formats.metadata.dimap.read_dimap` has checked its profile.

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
    epoch, timing = _timing(model.one("Time/Time_Range"), model.one("Time/Time_Stamp/LINE_PERIOD"), n_lines)
    span_s = timing.reference_time_s + timing.line_period_s * np.linspace(0.0, n_lines - 1.0, 5)
    attitude, attitude_notes = _attitude(model.one("Attitudes"), epoch, span_s)
    look, look_notes = _look_angles(model, n_samples)
    points = model.every("Ephemeris/Point_List/Point", checks.MIN_EPHEMERIS_POINTS)
    frame_points = checks.frame_points(root.maybe("Dataset_Content/Dataset_Extent"), _FRAME_TAGS, "Center", None)
    return PushbroomMetadata(
        file=root.file,
        mission=mission,
        instrument=instrument,
        format=f"DIMAP {head.one('METADATA_FORMAT').element.get('version')}",
        epoch=epoch,
        n_lines=n_lines,
        n_samples=n_samples,
        timing=timing,
        ephemeris=_ephemeris(points, epoch, ("TIME", "LOCATION_XYZ", "VELOCITY_XYZ")),
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


def _timing(limits: XmlNode, line_period: XmlNode, n_lines: int) -> tuple[np.datetime64, LineTiming]:
    """Day and times of the lines; the line period has to fit the time range of the image."""
    epoch, start = limits.one("START").time()
    duration = limits.one("END").seconds_since(epoch) - float(start)
    period = line_period.number(MILLISECONDS, *checks.LINE_PERIOD_S)
    lines = period * (n_lines - 1)
    if not lines / MAX_DURATION_RATIO <= duration <= lines * MAX_DURATION_RATIO:
        raise line_period.fault("dimap.duration", f"{lines:.6g} s", duration=duration, n_lines=n_lines)
    return epoch, LineTiming(0.0, float(start), period)


def _ephemeris(points: list[XmlNode], epoch: np.datetime64, names: tuple[str, str, str]) -> Ephemeris:
    """State vectors; ``names`` are the tags of time, position and velocity."""
    time_s = checks.times([p.one(names[0]) for p in points], epoch)
    position = np.array([p.one(names[1]).vector(3, METRES) for p in points])
    velocity = np.array([p.one(names[2]).vector(3, METRES_PER_SECOND) for p in points])
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
    return _quaternion_polynomial(polynomial, polynomial, span_s), notes


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


def _quaternion_polynomial(node: XmlNode, models: XmlNode, span_s: Array) -> QuaternionPolynomial:
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
    _require_look_angles(node, look, n_samples, ("YLOS", "XLOS"))
    return look


def _require_look_angles(node: XmlNode, look: LookAnglePolynomial, n_samples: int, names: tuple[str, str]) -> None:
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


def _bias_note(model: XmlNode) -> tuple[Finding, ...]:
    biases = model.maybe("Geometric_Calibration/Instrument_Calibration/Instrument_Biases")
    if biases is None:
        return ()
    angles = [biases.one(name).number(RADIANS) for name in ("YAW", "PITCH", "ROLL")]
    if not any(angles):
        return ()
    return (finding("image.biases", biases_rad=angles),)


# --- PHR_DIMAP -------------------------------------------------------------------------------


def read_dimap_phr(root: XmlNode) -> PushbroomMetadata:
    """Read the rigorous model of a PHR_DIMAP document.

    Parameters
    ----------
    root : XmlNode
        Root of the document, ``PHR_Dimap_Document``.

    Raises
    ------
    InputError
        The product is no sensor image, has an RPC only, or a value is missing, malformed or implausible.
    """
    head = root.one("Metadata_Identification")
    version = head.one("METADATA_PROFILE").element.get("version", "")
    level = root.one("Product_Characteristics/PROCESSING_LEVEL")
    if level.text() != PHR_LEVEL:
        raise level.fault("dimap.other_level", f"PHR_DIMAP {version}, level {level.text()}")
    model = root.maybe(PHR_MODEL)
    if model is None:
        raise head.fault("dimap.rpc_file", f"PHR_DIMAP {version} without {PHR_MODEL.rpartition('/')[2]}")
    checks.require_pixel_origin(root, "Product_Frame/PIXEL_ORIGIN")
    n_lines, n_samples = checks.image_size(root, "Raster_Dimensions")
    period = model.one("SENSOR_LINE_PERIOD")
    epoch, timing = _timing(model.one("UTC_Sensor_Model_Range"), period, n_lines)
    span_s = timing.reference_time_s + timing.line_period_s * np.linspace(0.0, n_lines - 1.0, 5)
    attitudes = model.one("Sensor_Attitudes")
    platform = root.one("Data_Strip/Data_Strip_Identification")
    mission = f"{platform.one('PLATFORM_NAME').text()} {platform.one('PLATFORM_SERIAL_NUMBER').text()}"
    points = model.every("Sensor_Ephemeris/Point_List/Point", checks.MIN_EPHEMERIS_POINTS)
    frame_points = checks.frame_points(root.maybe("Product_Frame/Dataset_Frame"), _FRAME_TAGS, "Center", None)
    return PushbroomMetadata(
        file=root.file,
        mission=mission,
        instrument=mission,
        format=f"PHR_DIMAP {version}",
        epoch=epoch,
        n_lines=n_lines,
        n_samples=n_samples,
        timing=timing,
        ephemeris=_ephemeris(points, epoch, ("UTC_TIME", "LOCATION_VALUES", "VELOCITY_VALUES")),
        attitude=_quaternion_polynomial(attitudes, attitudes.one("Polynomial_Models"), span_s),
        look=_phr_look_angles(model.one("Sensor_Viewing_Model"), n_samples),
        frame_points=frame_points,
        frame_note=finding("image.frame_without_heights") if frame_points else None,
    )


def _phr_look_angles(viewing: XmlNode, n_samples: int) -> LookAnglePolynomial:
    retina, directions = viewing.one("Position_In_Retina"), viewing.one("Viewing_Directions")
    first = retina.one("FIRST_COL").integer(DIMAP_FIRST_PIXEL, n_samples)
    across, along = (
        node.one("COEFFICIENTS").vector(node.one("DEGREE").integer(0, MAX_DEGREE) + 1)
        for node in (directions.one("PsiX_Model"), directions.one("PsiY_Model"))
    )
    look = LookAnglePolynomial(float(first - DIMAP_FIRST_PIXEL), tan_psi_x=along, tan_psi_y=across)
    _require_look_angles(directions, look, n_samples, ("PsiY", "PsiX"))
    return look
