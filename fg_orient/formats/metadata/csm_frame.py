"""Read and write frame states of the Community Sensor Model (USGSCSM, ``USGS_ASTRO_FRAME_SENSOR_MODEL``).

A state is the name of its model and a JSON object. In CSM, the centre of the first pixel
is (0.5, 0.5). The seven parameters of a state are the projection centre (m) and a
quaternion (x, y, z, w), which rotates camera axes to body-fixed axes. The ideal
coordinates are ``f (x, y)/z``. The distortion converts them to measured millimetres.
``m_iTransL`` and ``m_iTransS`` convert these to detector pixels relative to
``m_ccdCenter`` (line, sample). The fields follow the published definitions
(docs/planetary.md). The three angles refer to the body-fixed axes.

If USGSCSM does not have the distortion of a camera, the writer fits one of its
distortions. The returned record states the differences.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from factors.arrays import Array
from fg_orient.formats.atomic import write_text
from fg_orient.formats.csm import DISTORTIONS, FRAME_MODEL, UNIT, body_of, common_fields, distortion_of, open_state
from fg_orient.formats.json_files import JsonFile
from fg_orient.formats.registry import Format
from fg_orient.model.errors import InputError
from fg_orient.sensors.focal_plane import Detector, Distortion
from fg_orient.sensors.framing import FramingCamera, FramingSensor, Taken, angles_of

#: A distortion is fitted and compared at this number of pixels per side of the image.
SIDE: Final = 41
#: A state gives these limits for heights above the ellipsoid and depths below it, m.
REACH_M: Final = 1_000.0
#: Rotates camera axes that look along the negative third axis to axes that look along the positive third axis.
_HALF_TURN: Final = np.diag([-1.0, 1.0, -1.0])


def read_state(path: str | Path) -> FramingSensor:
    """Read a frame state.

    Raises
    ------
    InputError
        A value is missing or impossible. Or the distortion is not radial, transverse, or
        radial and tangential. Or the principal point is not zero.
    """
    path = Path(path)
    state = open_state(path, FRAME_MODEL)
    parameters = state.numbers("m_currentParameterValue", 7)
    away = abs(float(np.linalg.norm(parameters[3:])) - 1.0)
    if away > UNIT:
        raise InputError.of("earth.quaternion", file=path, place="m_currentParameterValue", value=f"{away:.2g} off 1")
    principal = state.number("m_linePp", 0.0), state.number("m_samplePp", 0.0)
    if any(principal):
        raise InputError.of("csm.principal (failure): a principal point in the ideal coordinates is not read -> give a "
                            "state whose m_linePp and m_samplePp are zero", file=path, place="m_linePp, m_samplePp",
                            value=principal)  # fmt: skip
    focal = state.number("m_focalLength")
    if not focal > 0.0:
        raise InputError.of("csm.focal (failure): the focal length must be above zero -> correct m_focalLength",
                            file=path, place="m_focalLength", value=focal)  # fmt: skip
    from scipy.spatial.transform import Rotation  # loaded for these files only

    turn = Rotation.from_quat(parameters[3:]).as_matrix().T
    camera = FramingCamera(
        parameters[:3], angles_of(turn), np.eye(3), np.eye(3), focal, _detector(state), distortion_of(state)
    )  # fmt: skip
    taken = Taken(state.text("m_spacecraftName", ""), state.text("m_instrumentID", ""), "", "CSM state")
    size = state.count("m_nLines"), state.count("m_nSamples")
    return FramingSensor(camera, *size, body_of(state), taken=taken, file=str(path))


def _detector(state: JsonFile) -> Detector:
    lines, samples = state.numbers("m_iTransL", 3), state.numbers("m_iTransS", 3)
    centre = state.numbers("m_ccdCenter", 2).tolist()
    summing, start = (
        [state.number(name.format(axis), default) for axis in ("Line", "Sample")]
        for name, default in (("m_detector{}Summing", 1.0), ("m_startingDetector{}", 0.0))
    )  # fmt: skip
    if abs(np.linalg.det([lines[1:], samples[1:]])) < 1e-12 or not min(summing) > 0.0:
        raise InputError.of("isd.detector", file=state.path, place="m_iTransL, m_iTransS",
                            value=f"{lines[1:].tolist()}, {samples[1:].tolist()}")  # fmt: skip
    first, second = lines.tolist(), samples.tolist()
    return Detector(
        (centre[0], centre[1]), (first[0], first[1], first[2]), (second[0], second[1], second[2]),
        (summing[0], summing[1]), (start[0], start[1]),
    )  # fmt: skip


# --- writing -----------------------------------------------------------------------------------------


def write_state(path: Path, sensor: Any, correction: Any = None) -> dict[str, Any]:
    """Write the state of a frame image with its correction (6,) from an adjustment.

    Returns
    -------
    dict
        ``distortion``; ``largest_px`` and ``mean_px``, the differences of the written camera over the image.

    Raises
    ------
    InputError
        The sensor is not a frame image with inertial axes.
    """
    if not isinstance(sensor, FramingSensor):
        raise InputError.of("csm.frame (failure): only a frame image of an ISD or of a CSM state becomes a frame state "
                            "-> give such metadata", file=sensor.file, value=type(sensor).__name__)  # fmt: skip
    camera = _forward(sensor.camera.corrected(correction))
    written = _fitted(camera, sensor)
    write_text(path, f"{FRAME_MODEL}\n{json.dumps(_fields(sensor, written), indent=2)}\n")
    apart = _differences(camera, written, sensor)
    return {"distortion": written.distortion.model, "largest_px": float(apart.max()), "mean_px": float(apart.mean())}


def _forward(camera: FramingCamera) -> FramingCamera:
    """Return the same camera with a positive focal length.

    Its axes are rotated by 180 degrees about axis 2.
    """
    if camera.focal_mm > 0.0:
        return camera
    detector, distortion = camera.detector, camera.distortion
    (l0, l1, l2), (s0, s1, s2) = detector.lines, detector.samples
    return replace(
        camera, mounting=_HALF_TURN @ camera.mounting, focal_mm=-camera.focal_mm,
        detector=replace(detector, lines=(l0, -l1, l2), samples=(s0, -s1, s2)), distortion=distortion.mirrored(),
    )  # fmt: skip


def _fitted(camera: FramingCamera, sensor: FramingSensor) -> FramingCamera:
    """Return a camera that a state can contain.

    The result is the given camera, or the camera with the smallest difference over the image.
    A radial and tangential distortion gets its own rotation and affine detector, so that it contains the
    decentring and the principal point of metric cameras.
    """
    own = camera.distortion
    if own.model in DISTORTIONS.values():
        return camera
    if own.model == "none":
        return replace(camera, distortion=Distortion("radial", (0.0, 0.0, 0.0)))
    measured = camera.detector.millimetres(*sensor.grid(SIDE))
    ideal = own.ideal(measured)
    x, y = ideal.T
    terms = np.stack([x**0, x, y, x * x, x * y, y * y, x**3, x * x * y, x * y * y, y**3], axis=1)
    transverse = Distortion("transverse", tuple(_solved(terms, measured).T.ravel().tolist()))
    r = np.sum(measured**2, axis=1)
    powers = np.concatenate([measured[:, i, None] * np.stack([r**0, r, r * r], axis=1) for i in range(2)])
    radial = Distortion("radial", tuple(_solved(powers, (measured - ideal).T.ravel()).tolist()))
    nearest = [replace(camera, distortion=d) for d in (transverse, radial)] + [_radtan(camera, measured, ideal)]
    return min(nearest, key=lambda one: _differences(camera, one, sensor).max())


def _radtan(camera: FramingCamera, measured: Array, ideal: Array) -> FramingCamera:
    """Camera with radial and tangential distortion that is nearest at measured and ideal coordinates (n, 2) mm.

    Unknowns are a rotation and the coefficients; the affine map from distorted to measured coordinates is linear.
    """
    from scipy.optimize import least_squares  # loaded for these files only
    from scipy.spatial.transform import Rotation

    focal, ones = camera.focal_mm, np.ones((len(ideal), 1))
    rays = np.hstack([ideal, focal * ones])

    def parts(unknowns: Array) -> tuple[Array, Distortion, Array]:
        """Rotation, distortion, and affine terms (n, 3) of all pixels."""
        turn = Rotation.from_rotvec(unknowns[:3]).as_matrix()
        seen = rays @ turn.T
        distortion = Distortion("radtan", (*map(float, unknowns[3:]), focal))
        return turn, distortion, np.hstack([ones, distortion.measured(focal * seen[:, :2] / seen[:, 2:])])

    def misfit(unknowns: Array) -> Array:
        affine = parts(unknowns)[2]
        return np.asarray((affine @ _solved(affine, measured) - measured).ravel())

    found = least_squares(misfit, np.zeros(8), method="lm", xtol=1e-14, ftol=1e-14, x_scale=[0.01] * 3 + [0.1] * 5).x
    turn, distortion, affine = parts(found)
    (shift_x, shift_y), *back = _solved(affine, measured)
    per_mm = np.array([camera.detector.lines[1:], camera.detector.samples[1:]])
    shift, per_mm = per_mm @ [shift_x, shift_y], per_mm @ np.array(back).T
    lines, samples = (
        (float(first + own), float(a), float(b))
        for first, own, (a, b) in zip(
            (camera.detector.lines[0], camera.detector.samples[0]), shift, per_mm, strict=True
        )
    )
    detector = replace(camera.detector, lines=lines, samples=samples)
    return replace(camera, mounting=turn @ camera.mounting, detector=detector, distortion=distortion)


def _solved(terms: Array, values: Array) -> Array:
    """Least-squares coefficients of terms of any size."""
    size = np.abs(terms).max(axis=0)
    found = np.linalg.lstsq(terms / size, values, rcond=None)[0]
    return np.asarray((found.T / size).T)


def _differences(one: FramingCamera, other: FramingCamera, sensor: FramingSensor) -> Array:
    """Return the distances (n,), px, between the pixels that both cameras give for the same lines of sight."""
    line, sample = sensor.grid(SIDE)
    ideal = one.distortion.ideal(one.detector.millimetres(line, sample))
    seen = np.column_stack([ideal, np.full(len(ideal), one.focal_mm)]) @ (other.mounting @ one.mounting.T).T
    there = other.detector.pixels(other.distortion.measured(other.focal_mm * seen[:, :2] / seen[:, 2:]))
    return np.asarray(np.hypot(there[0] - line, there[1] - sample))


def _fields(sensor: FramingSensor, camera: FramingCamera) -> dict[str, Any]:
    """Return all fields of a state; fields that the model does not use have neutral values."""
    from scipy.spatial.transform import Rotation  # loaded for these files only

    detector, centre = camera.detector, camera.centre_m
    quaternion = Rotation.from_matrix(camera.rotation.T).as_quat().tolist()
    affine = np.array([detector.samples, detector.lines])
    back = np.linalg.inv(affine[:, 1:])  # detector samples and lines to millimetres
    shift = (-back @ affine[:, 0]).tolist()
    size, own = (sensor.n_lines, sensor.n_samples), camera.distortion
    return {
        **common_fields(FRAME_MODEL, sensor, size, detector, camera.focal_mm, own, sensor.centre_m, REACH_M),
        "m_spacecraftName": sensor.taken.platform,
        "m_instrumentID": sensor.taken.instrument, "m_targetName": "EARTH" if sensor.body is None else sensor.body.name,
        "m_currentParameterValue": [*centre.tolist(), *quaternion], "m_currentParameterCovariance": [0.0] * 49,
        "m_noAdjustments": [0.0] * 7, "m_focalLengthEpsilon": 0.0, "m_boresight": [0.0, 0.0, 1.0],
        "m_transX": [shift[0], *back[0].tolist()], "m_transY": [shift[1], *back[1].tolist()],
        "m_ccdCenter": list(detector.centre), "m_linePp": 0.0, "m_samplePp": 0.0,
        "m_pixelPitch": float(np.linalg.norm(back[:, 0])), "m_ifov": 0.0, "m_lineJitter": 0.0, "m_sampleJitter": 0.0,
        "m_originalHalfLines": sensor.n_lines / 2.0, "m_originalHalfSamples": sensor.n_samples / 2.0,
        "m_ephemerisTime": 0.0, "m_spacecraftVelocity": [0.0, 0.0, 0.0], "m_collectionIdentifier": "",
    }  # fmt: skip


FORMAT = Format(
    name="csm-frame", title="CSM frame state",
    sniff=lambda path, head: FRAME_MODEL in head[:4000] and '"name_model"' not in head,
    read_image=read_state, write_image=write_state,
)  # fmt: skip
