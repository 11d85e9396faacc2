"""Read sensor products in DIMAP 2.x (Pléiades 1A/1B, SPOT 6/7) and in PHR_DIMAP, the inventory format of CNES.

Source: docs/equations.md 4 (Terlemezoğlu 2019, eqs. 2.35-2.43 as corrected). The conventions
were verified with a Pléiades pair: the model agrees with the vendor's RPC within 0.003 px.

The time of a line is ``START + (line - 1) LINE_PERIOD``; lines are counted from 1.
Quaternions rotate the vendor's body axes (x along track, y across track, z to the Earth)
to ECEF. Their scalar part ``Q0`` is first. The look direction in the body axes is
``(YLOS, -XLOS, 1)``. XLOS and YLOS are tangents, given as polynomials of the column minus
``FIRST_COL``. ``XLOS`` is our ``tan psi_y`` (across track), ``YLOS`` is our ``tan psi_x``
(along track).

PHR_DIMAP contains the same model in other elements. ``Sensor_Model_Characteristics`` contains
the time of the first line (``UTC_Sensor_Model_Range/START``), ``SENSOR_LINE_PERIOD`` (ms),
state vectors, polynomial quaternions, and the tangents ``PsiX`` (across track, the XLOS of
DIMAP 2) and ``PsiY`` (along track, YLOS). The file also contains acquisition lines with other
periods (``PA_LINE_PERIOD``), inertial quaternions and times in TAI. They do not belong to the
image of the product and are not read. For a real file, the model agrees with the RPC of the
file within 0.5 mm, and with the grid of its physical model within 1 cm.
"""

from __future__ import annotations

import math
import re

import numpy as np

from factors.arrays import Array
from factors.geometry.interpolation import sign_aligned
from fg_orient.formats import dimap_checks as checks
from fg_orient.formats.dimap_checks import DIMAP_FIRST_PIXEL
from fg_orient.formats.xml import MILLISECONDS, RADIANS, SECONDS, XmlNode
from fg_orient.model.errors import Finding, finding
from fg_orient.sensors.metadata import (
    LineTiming,
    LookAnglePolynomial,
    PushbroomMetadata,
    QuaternionList,
    QuaternionPolynomial,
)

#: Profiles that can be read. The mission is used if the file does not name one.
PROFILES = {"PHR_SENSOR": "PHR", "S6_SENSOR": "SPOT 6", "S7_SENSOR": "SPOT 7"}
#: Quaternion polynomials are fitted to a scaled time between -1 and 1. A larger value
#: than this limit shows that the day or the unit of the time is wrong.
MAX_SCALED_TIME = 2.0
#: The time from START to END must agree with the number of lines times LINE_PERIOD within
#: this factor. A wrong unit changes it by a factor of 1000.
MAX_DURATION_RATIO = 2.0
MAX_DEGREE = 10
MODEL = "Geometric_Data/Refined_Model"
_LAYOUT = checks.Layout(
    "Geoposition/Raster_CS/PIXEL_ORIGIN", "Raster_Data/Raster_Dimensions", f"{MODEL}/Ephemeris/Point_List/Point",
    "Dataset_Content/Dataset_Extent", ("TIME", "LOCATION_XYZ", "VELOCITY_XYZ"),
)  # fmt: skip
PHR_ROOT = "PHR_Dimap_Document"
PHR_MODEL = "Geometric_Data/Sensor_Model_Characteristics"
#: Processing level of the products of PHR_DIMAP that can be read.
PHR_LEVEL = "SENSOR"
_PHR_LAYOUT = checks.Layout(
    "Product_Frame/PIXEL_ORIGIN", "Raster_Dimensions", f"{PHR_MODEL}/Sensor_Ephemeris/Point_List/Point",
    "Product_Frame/Dataset_Frame", ("UTC_TIME", "LOCATION_VALUES", "VELOCITY_VALUES"),
)  # fmt: skip


def read_dimap2(root: XmlNode) -> PushbroomMetadata:
    """Read the metadata of a Pléiades 1A/1B or SPOT 6/7 sensor product.

    InputError: a value is invalid; the first one is named.
    """
    size = checks.image_size(root, _LAYOUT)
    head, model = root.one("Metadata_Identification"), root.one(MODEL)
    mission, instrument = _mission(root)
    epoch, timing, span_s = _timing(model.one("Time/Time_Range"), model.one("Time/Time_Stamp/LINE_PERIOD"), size[0])
    attitude, attitude_notes = _attitude(model.one("Attitudes"), epoch, span_s)
    look, look_notes = _look_angles(model, size[1])
    return checks.metadata(
        root, _LAYOUT, size, epoch, timing, mission=mission, instrument=instrument, attitude=attitude, look=look,
        format=f"DIMAP {head.one('METADATA_FORMAT').element.get('version')}",
        notes=attitude_notes + look_notes + _bias_note(model),
    )  # fmt: skip


def _mission(root: XmlNode) -> tuple[str, str]:
    """Return mission and instrument.

    If a file has no Strip_Source, its profile determines the mission.
    """
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


def _timing(limits: XmlNode, line_period: XmlNode, n_lines: int) -> tuple[np.datetime64, LineTiming, Array]:
    """Return the day, the line timing, and five times (5,) s spread over the image.

    The line period must agree with the time range of the file.
    """
    epoch, start = limits.one("START").time()
    duration = limits.one("END").seconds_since(epoch) - float(start)
    period = line_period.number(MILLISECONDS, *checks.LINE_PERIOD_S)
    lines = period * (n_lines - 1)
    if not lines / MAX_DURATION_RATIO <= duration <= lines * MAX_DURATION_RATIO:
        raise line_period.fault("dimap.duration", f"{lines:.6g} s", duration=duration, n_lines=n_lines)
    return epoch, LineTiming(0.0, float(start), period), float(start) + period * np.linspace(0.0, n_lines - 1.0, 5)


# --- attitude --------------------------------------------------------------------------------


def _attitude(
    source: XmlNode, epoch: np.datetime64, span_s: Array
) -> tuple[QuaternionList | QuaternionPolynomial, tuple[Finding, ...]]:
    polynomial = source.maybe("Polynomial_Quaternions")
    if polynomial is None:
        return _quaternion_list(source, epoch)
    notes = (finding("image.two_attitudes"),) if source.maybe("Quaternion_List") else ()
    return _quaternion_polynomial(polynomial, polynomial, span_s), notes


def _quaternion_list(source: XmlNode, epoch: np.datetime64) -> tuple[QuaternionList, tuple[Finding, ...]]:
    """Read sampled quaternions and normalise them.

    Their signs are chosen so that neighbours are similar.
    """
    nodes = source.every("Quaternion_List/Quaternion", 2)
    time_s = checks.times([n.one("TIME") for n in nodes], epoch)
    quaternion = np.array([[n.one(f"Q{j}").number() for j in range(4)] for n in nodes])
    checks.require_unit_quaternions(nodes, quaternion)
    notes = checks.flagged(nodes, "Q_STATUS", "NOMINAL", "image.quaternion_flags")
    return QuaternionList(time_s, sign_aligned(quaternion)), notes


def _quaternion_polynomial(node: XmlNode, models: XmlNode, span_s: Array) -> QuaternionPolynomial:
    """Read the polynomials ``models/Q0`` to ``Q3`` of the time, which is scaled by ``node/OFFSET`` and ``SCALE``.

    At the times ``span_s`` (n,) of the image, their values must be unit quaternions.

    Raises
    ------
    InputError
        The polynomials belong to another time, or they are not rotations.
    """
    scale_node = node.one("SCALE")
    offset, scale = node.one("OFFSET").number(SECONDS), scale_node.number(SECONDS, 1e-3, 1e4)
    scaled = (span_s - offset) / scale
    if np.abs(scaled).max() > MAX_SCALED_TIME:
        seen = f"scaled time {scaled[0]:.4g} .. {scaled[-1]:.4g}"
        raise scale_node.fault("dimap.quaternion_span", seen, limit=MAX_SCALED_TIME)
    rows = [_polynomial(models.one(f"Q{j}")) for j in range(4)]
    coefficients = np.zeros((4, max(map(len, rows))))
    for j, row in enumerate(rows):
        coefficients[j, : len(row)] = row
    values = (scaled[:, None] ** np.arange(coefficients.shape[1])) @ coefficients.T
    checks.require_unit_quaternions([node] * len(values), values)
    return QuaternionPolynomial(offset, scale, coefficients)


def _polynomial(node: XmlNode) -> Array:
    """Read the coefficients of a polynomial whose degree the file states.

    The constant term is first.
    """
    return node.one("COEFFICIENTS").vector(node.one("DEGREE").integer(0, MAX_DEGREE) + 1)


# --- look angles -----------------------------------------------------------------------------


def _look_angles(model: XmlNode, n_samples: int) -> tuple[LookAnglePolynomial, tuple[Finding, ...]]:
    """Read the look polynomials of the panchromatic band.

    If there is no such band, the first band is used.
    """
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
    node = band.one("Polynomial_Look_Angles")
    along, across = _coefficients(node, "YLOS", at_least=1), _coefficients(node, "XLOS", at_least=2)
    return _look(band.one("Swath_Range"), node, {"YLOS": along, "XLOS": across}, n_samples)


def _look(swath: XmlNode, node: XmlNode, tangents: dict[str, Array], n_samples: int) -> LookAnglePolynomial:
    """Read the polynomials of the tangents along and across track from elements of these names.

    Angles above 45 degrees are refused.
    """
    first = swath.one("FIRST_COL").integer(DIMAP_FIRST_PIXEL, n_samples)
    column = np.array([0.0, (n_samples - 1) / 2, n_samples - 1.0]) - (first - DIMAP_FIRST_PIXEL)
    for name, row in tangents.items():
        tangent = np.polynomial.polynomial.polyval(column, row)
        worst = float(tangent[np.abs(tangent).argmax()])
        if not abs(worst) <= math.tan(checks.MAX_LOOK_ANGLE_RAD):
            raise node.fault("dimap.look_angle", f"{name} = {worst:.6g}")
    return LookAnglePolynomial(float(first - DIMAP_FIRST_PIXEL), *tangents.values())


def _coefficients(node: XmlNode, name: str, at_least: int) -> Array:
    """Read the coefficients ``name_0``, ``name_1``, ...

    None may be missing, and the constant term is first.
    """
    powers = [int(m[1]) for child in node.children() if (m := re.fullmatch(rf"{name}_([0-9]{{1,2}})", child.tag))]
    count = max(at_least, max(powers, default=0) + 1)
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
    """Read the metadata of a PHR_DIMAP document.

    Raises
    ------
    InputError
        The product is not a sensor image or has only an RPC, or a value is missing, malformed or implausible.
    """
    head = root.one("Metadata_Identification")
    version = head.one("METADATA_PROFILE").element.get("version", "")
    level = root.one("Product_Characteristics/PROCESSING_LEVEL")
    if level.text() != PHR_LEVEL:
        raise level.fault("dimap.other_level", f"PHR_DIMAP {version}, level {level.text()}")
    model = root.maybe(PHR_MODEL)
    if model is None:
        raise head.fault("dimap.rpc_file", f"PHR_DIMAP {version} without {PHR_MODEL.rpartition('/')[2]}")
    size = checks.image_size(root, _PHR_LAYOUT)
    epoch, timing, span_s = _timing(model.one("UTC_Sensor_Model_Range"), model.one("SENSOR_LINE_PERIOD"), size[0])
    attitudes, viewing = model.one("Sensor_Attitudes"), model.one("Sensor_Viewing_Model")
    directions = viewing.one("Viewing_Directions")
    platform = root.one("Data_Strip/Data_Strip_Identification")
    mission = f"{platform.one('PLATFORM_NAME').text()} {platform.one('PLATFORM_SERIAL_NUMBER').text()}"
    tangents = {name: _polynomial(directions.one(f"{name}_Model")) for name in ("PsiY", "PsiX")}
    return checks.metadata(
        root, _PHR_LAYOUT, size, epoch, timing, mission=mission, instrument=mission, format=f"PHR_DIMAP {version}",
        attitude=_quaternion_polynomial(attitudes, attitudes.one("Polynomial_Models"), span_s),
        look=_look(viewing.one("Position_In_Retina"), directions, tangents, size[1]),
    )  # fmt: skip
