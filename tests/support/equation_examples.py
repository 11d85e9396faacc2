"""Random states of the registered equations of ``factors`` serve the generic tests.

Each state is well posed. Over many draws a state covers every branch of its equation.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from factors._contract import Array, Equation
from factors.cameras import dlt as dlt_equation
from factors.cameras import (
    frame,
    frame_angles,
    frame_corrections,
    frame_extended,
    plane,
    pushbroom,
    pushbroom_record,
    rfm_equation,
)
from factors.conditions import (
    circles,
    constraints,
    control,
    coplanarity,
    curves,
    latitudinal,
    navigation,
    similarity,
    surfaces,
)
from factors.conditions.navigation import ATTITUDE, POSITION
from factors.geometry import rotations

_NONE = np.zeros((2, 0))


class Example(NamedTuple):
    """Constants of an observation and values of its unknowns: record (d,), setup (2, k), one vector per argument."""

    record: Array
    setup: Array
    unknowns: tuple[Array, ...]


def random_rotation(rng: np.random.Generator) -> Array:
    """Draw a rotation (3, 3)."""
    out, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return np.asarray(out * np.sign(np.linalg.det(out)))


def look_angle_collinearity(rng: np.random.Generator) -> Example:
    """Return a SPOT-like observation.

    Both kinds of files, both attitude forms and curves occur.
    """
    p = rng.normal(size=3)
    p *= 7.2e6 / np.linalg.norm(p)
    v = np.cross(p, rng.normal(size=3))
    v = 7400.0 * v / np.linalg.norm(v) + 8.0 * p / np.linalg.norm(p)
    psi_x, psi_y = rng.uniform(-0.02, 0.02), rng.uniform(-0.4, 0.4)
    ray = rotations.orbital_frames(p[None], v[None])[0] @ np.array([-np.tan(psi_y), np.tan(psi_x), -1.0])
    turn = rotations.attitude_matrices(rng.normal(scale=1e-3, size=(1, 3)), False)[0]
    record = pushbroom.RECORD.pack(
        position=p, velocity=v, angles=rng.normal(scale=1e-3, size=3), mounting=turn.ravel(), tau=rng.uniform(-1, 1),
        look=[psi_x, psi_y], s=rng.uniform(-1, 1), whitening=rng.normal(scale=5e5, size=4),
        follows=rng.integers(0, 2), small_angle=rng.integers(0, 2), reference=np.zeros(3), from_position=8.4e5 * ray,
    )  # fmt: skip
    sigma = np.repeat([[10.0, 1.0, 0.1], [1e-2, 1e-3, 1e-4], [5e-5, 1e-5, 2e-6]], 3, axis=0).ravel()
    curve, curves = pushbroom_record.CURVE, pushbroom_record.CURVES
    codes = np.arange(pushbroom_record.N_EOP + 6.0)
    codes = np.concatenate([codes, [curve, curve + curves + 1.0, curve + 7.0 * curves]])
    setup = np.ascontiguousarray(np.stack([codes, np.concatenate([sigma, np.full(6, 1e-4), [1.0, 1.0, 1e-5]])]))
    unknowns = rng.normal(size=len(codes)), rng.normal(scale=100.0, size=3)
    return Example(np.concatenate([record, rng.normal(size=2)]), setup, unknowns)


def frame_collinearity(rng: np.random.Generator) -> Example:
    """Return a ray of a wide-angle camera.

    Both directions of the polynomial, small and large rotations, and subsets of unknowns occur.
    """
    start, n = random_rotation(rng), frame.N_UNKNOWNS
    centre, depth = rng.normal(scale=100.0, size=3), rng.uniform(50.0, 500.0)
    ground = centre + start.T @ (depth * np.array([*rng.uniform(-0.4, 0.4, 2), 1.0]))
    focal, principal = rng.uniform(500.0, 5e3), rng.uniform(-50.0, 50.0, 2)
    distortion, (line, sample) = rng.normal(size=5) * np.repeat([0.05, 1e-3], [3, 2]), rng.uniform(-1e3, 1e3, 2)
    a_line, a_sample = 1.0 / rng.uniform(0.2, 2.0, 2)
    sigma = np.repeat([rng.choice([1e-5, 1e-3, 0.1]), 0.3, 3.0, 2.0, 1e-2, 1e-4, 1e-3], [3, 3, 1, 2, 3, 2, 1])
    codes = np.sort(rng.permutation(n)[: rng.integers(1, n + 1)])
    setup = np.stack([codes.astype(float), sigma[codes]])
    if rng.random() < 0.3:
        setup = np.column_stack([setup, [n + 2.0, 1.0]])
    aspect, unit = (rng.normal(scale=1e-3), focal * rng.uniform(0.5, 2.0)) if rng.random() < 0.5 else (0.0, 0.0)
    record = frame.RECORD.pack(
        line=line, sample=sample, a_line=a_line, a_sample=a_sample, rotation=start.ravel(), centre=centre, focal=focal,
        principal=principal, distortion=distortion, aspect=aspect, unit=unit,
    )  # fmt: skip
    x = rng.normal(size=len(setup[0]))
    return Example(record, np.ascontiguousarray(setup), (x, ground + rng.normal(scale=1.0, size=3)))


def frame_angles_collinearity(rng: np.random.Generator) -> Example:
    """Return the camera that looks forwards or backwards along its third axis; any angles, subsets of unknowns."""
    angles, inertial, mounting = rng.uniform(-1.4, 1.4, 3), random_rotation(rng), random_rotation(rng)
    centre, focal = rng.normal(scale=1e3, size=3), rng.choice([-1.0, 1.0]) * rng.uniform(20.0, 200.0)
    f, s, t = 0.5 * np.pi + angles[0], 0.5 * np.pi - angles[1], angles[2]
    rotation = mounting @ _axis_turn(2, t) @ _axis_turn(0, s) @ _axis_turn(2, f) @ inertial
    ideal = rng.uniform(-0.4, 0.4, 2)
    ground = centre + rotation.T @ (rng.uniform(50.0, 500.0) * np.array([*ideal, 1.0]) * np.sign(focal))
    codes = np.sort(rng.permutation(6)[: rng.integers(1, 7)])
    sigma = np.repeat([3.0, rng.choice([1e-5, 1e-3, 0.1])], 3)
    record = frame_angles.RECORD.pack(
        ideal=focal * ideal, whitening=rng.normal(scale=100.0, size=4), angles=angles, inertial=inertial.ravel(),
        mounting=mounting.ravel(), centre=centre, focal=focal,
    )  # fmt: skip
    setup = np.ascontiguousarray(np.stack([codes.astype(float), sigma[codes]]))
    return Example(record, setup, (rng.normal(size=len(codes)), ground + rng.normal(size=3)))


def _axis_turn(axis: int, angle: float) -> Array:
    """Return the rotation of the axes about one of them."""
    i, j, out = (axis + 1) % 3, (axis + 2) % 3, np.eye(3)
    out[[i, i, j, j], [i, j, i, j]] = np.cos(angle), np.sin(angle), -np.sin(angle), np.cos(angle)
    return out


def latitudinal_point(rng: np.random.Generator) -> Example:
    """Return the point near its observed place, anywhere on a sphere but the poles."""
    lon, lat, radius = rng.uniform(-np.pi, np.pi), rng.uniform(-1.4, 1.4), rng.uniform(1e3, 1e4)
    place = radius * np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    origin = place + rng.normal(scale=100.0, size=3)
    record = latitudinal.RECORD.pack(origin=origin, observed=[lon, lat, radius], sigma=rng.uniform(0.5, 50.0, 3))
    return Example(record, _NONE, (place - origin + rng.normal(scale=30.0, size=3),))


def rational_function(rng: np.random.Generator) -> Example:
    """Return an observation in an image of metre resolution.

    Shift, drift and affine compensation occur.
    """
    c = rng.normal(scale=1e-3, size=(4, 20))
    c[1::2, 0] = 1.0
    c[0, 1:4] += 0.1 * rng.normal(), -1.0, 0.1 * rng.normal()
    c[2, 1:4] += 1.0, 0.1 * rng.normal(), 0.1 * rng.normal()
    lon, lat = rng.uniform(-np.pi, np.pi), rng.uniform(-1.4, 1.4)
    line, sample = rng.uniform(0.0, 2e4, 2)
    record = rfm_equation.RECORD.pack(
        line=line, sample=sample, whitening=(np.eye(2) + 0.2 * rng.normal(size=(2, 2))).ravel() / 0.5, line_offset=1e4,
        sample_offset=1.2e4, line_scale=1e4, sample_scale=1.2e4, normalised=rng.uniform(-1, 1, 3),
        scales=[2e-3 / np.cos(lat), -1.6e-3, 500.0], reference=rng.normal(scale=1e3, size=3),
        frame=[np.sin(lon), np.cos(lon), np.sin(lat), np.cos(lat), rng.uniform(-100.0, 3e3)], coefficients=c.ravel(),
    )  # fmt: skip
    codes = list(rfm_equation.COMPENSATIONS.values())[rng.integers(0, 3)]
    setup = np.ascontiguousarray(np.stack([np.array(codes, float), rng.uniform(0.5, 10.0, len(codes))]))
    x, away = rng.normal(size=len(codes)), rng.normal(scale=300.0, size=3)
    return Example(record, setup, (x, record[rfm_equation.RECORD.reference] + away))


def frame_extended_collinearity(rng: np.random.Generator) -> Example:
    """Return a ray of a frame image with all corrections.

    Both directions, fisheye and perspective, lines up and down, and conditions occur.
    """
    plain = frame_collinearity(rng)
    constants = dict(zip(frame.RECORD.fields, np.split(plain.record, np.cumsum([*frame.RECORD.sizes.values()])[:-1]),
                         strict=True))  # fmt: skip
    further, shear = frame_corrections.FURTHER, rng.normal(scale=1e-3)
    values = {name: rng.normal(scale=1e-3, size=size) for name, size in further.sizes.items()} | {"shear": shear}
    if rng.random() < 0.3:
        values |= {name: np.zeros(further.sizes[name]) for name in ("additional", "variants")}
    record = frame_extended.RECORD.pack(
        **{name: value if frame.RECORD.sizes[name] > 1 else value[0] for name, value in constants.items()}, **values,
        is_fisheye=rng.integers(0, 2), sign=rng.choice([-1.0, 1.0]), nominal=1.1, radius=rng.uniform(0.4, 1.0),
        w12=rng.normal(), power=rng.integers(0, 2),
    )  # fmt: skip
    n = rng.integers(0, further.size + 1)
    codes = frame_extended.N_UNKNOWNS - further.size + rng.permutation(further.size)[:n]
    plain_codes = plain.setup[:, plain.setup[0] < frame.N_UNKNOWNS]
    silent = [[frame_extended.UNKNOWN.navigation.start + 2.0], [1.0]]
    setup = np.concatenate([plain_codes, np.stack([codes, np.full(n, 1e-3)]), silent], axis=1)
    return Example(record, np.ascontiguousarray(setup), (rng.normal(size=setup.shape[1]), plain.unknowns[1]))


def _plane_record(rng: np.random.Generator) -> Array:
    """Return the record of a normalised point with correlated coordinates."""
    w11, w12, w22 = rng.uniform(0.5, 2.0), rng.normal(), rng.uniform(0.5, 2.0)
    source, target = rng.uniform(-1.0, 1.0, 3), rng.uniform(-1.0, 1.0, 2)
    return plane.RECORD.pack(source=source, target=target, w11=w11, w12=w12, w22=w22)


def dlt(rng: np.random.Generator) -> Example:
    """Return a point of the DLT with eleven parameters and some coefficients of the distortion."""
    x = np.concatenate([rng.normal(size=8), rng.uniform(-0.2, 0.2, 3)])
    most = dlt_equation.N_DISTORTION
    codes = np.sort(rng.permutation(most)[: rng.integers(0, most + 1)]).astype(float)
    setup = np.ascontiguousarray(np.stack([codes, rng.uniform(0.01, 0.1, len(codes))]))
    record = np.concatenate([_plane_record(rng), rng.normal(scale=0.2, size=2)])
    return Example(record, setup, (np.concatenate([x, rng.normal(size=len(codes))]),))


def plane_transformation(n_linear: int, n_quotient: int = 0) -> Callable[[np.random.Generator], Example]:
    """Return a function that draws a transformation with these numbers of unknowns.

    They are those of numerators and denominators. With 0 numerators it is a polynomial of any degree.
    """

    def draw(rng: np.random.Generator) -> Example:
        degree = 0 if n_linear else int(rng.integers(1, plane.MAX_DEGREE + 1))
        setup = _NONE if n_linear else plane.polynomial_setup(degree)
        c = rng.normal(size=n_linear or 2 * setup.shape[1])
        return Example(_plane_record(rng), setup, (np.concatenate([c, rng.uniform(-0.1, 0.1, n_quotient)]),))

    return draw


def _turned(rng: np.random.Generator, angle_rad: float) -> Array:
    return np.asarray(navigation._rotation(np.eye(3).ravel(), rng.normal(size=3) * angle_rad)[0])


def _navigation_parts(rng: np.random.Generator) -> tuple[Array, Array, Array, Array]:
    """Return the rotations R_0 and B_0, setup and unknowns.

    Large and small corrections occur, and subsets of unknowns.
    """
    most = navigation.UNKNOWN.size
    codes = np.sort(rng.permutation(most)[: rng.integers(1, most + 1)])
    sigma = np.repeat([rng.choice([1e-5, 1e-2, 0.2]), 0.3, 1.0, 0.5, 0.1, 1e-3, 1e-4, 0.05, 1e-2],
                      [3, 3, 9, 3, 3, 3, 3, 3, 3])  # fmt: skip
    setup = np.ascontiguousarray(np.stack([codes.astype(float), sigma[codes]]))
    return _turned(rng, 1.0), _turned(rng, 1.0), setup, rng.normal(size=len(codes))


def antenna_position(rng: np.random.Generator) -> Example:
    """Return an observed position of an antenna."""
    rotation, mounting, setup, x = _navigation_parts(rng)
    record = POSITION.pack(
        offset=rng.normal(scale=0.5, size=3), arm=rng.normal(size=3), strip=_turned(rng, 1.0).ravel(),
        whitening=rng.normal(size=9), rotation=rotation.ravel(), mounting=mounting.ravel(), tau=rng.uniform(-1, 1),
    )  # fmt: skip
    return Example(record, setup, (x,))


def inertial_attitude(rng: np.random.Generator) -> Example:
    """Return the attitude of an inertial unit, near its observation or far from it."""
    rotation, mounting, setup, x = _navigation_parts(rng)
    away = _turned(rng, rng.choice([0.0, 1e-5, 1e-2, 0.5]))
    record = ATTITUDE.pack(
        whitening=rng.normal(size=9), rotation=rotation.ravel(), mounting=mounting.ravel(), tau=rng.uniform(-1, 1),
        observed=(away @ mounting.T @ rotation).ravel(),
    )  # fmt: skip
    return Example(record, setup, (x,))


def circle(rng: np.random.Generator) -> Example:
    """Return the tilted circle."""
    normal, e_1, e_2 = np.linalg.qr(rng.normal(size=(3, 3)))[0].T
    record = circles.CIRCLE_RECORD.pack(factor=rng.uniform(0.5, 2.0), normal=normal, e_1=e_1, e_2=e_2)
    return Example(record, _NONE, (rng.normal(scale=0.3, size=6), rng.normal(size=3)))


def equal_attitude(rng: np.random.Generator) -> Example:
    """Return the state of two cameras."""
    first, second, between = (random_rotation(rng).ravel() for _ in range(3))
    record = circles.ATTITUDE_RECORD.pack(factor=rng.uniform(0.5, 2.0), first=first, second=second, between=between)
    return Example(record, _NONE, (rng.normal(scale=0.3, size=3), rng.normal(scale=0.3, size=3)))


def _figure(rng: np.random.Generator) -> Array:
    factor, place, axes = rng.uniform(0.5, 2.0), rng.normal(size=3), np.linalg.qr(rng.normal(size=(3, 3)))[0].T
    return constraints.FIGURE.pack(factor=factor, place=place, normal=axes[0], e_1=axes[1], e_2=axes[2])


def ellipsoid(rng: np.random.Generator) -> Example:
    """Return the ellipsoid with a subset of its unknowns."""
    start, most = random_rotation(rng), surfaces.UNKNOWN.size
    record = surfaces.RECORD.pack(factor=rng.uniform(0.5, 2.0), centre=rng.normal(size=3), rotation=start.ravel(),
                                  semi_axes=rng.uniform(1.0, 3.0, 3))  # fmt: skip
    codes = np.sort(rng.permutation(most)[: rng.integers(1, most + 1)]).astype(float)
    setup = np.ascontiguousarray(np.stack([codes, rng.uniform(0.02, 0.3, len(codes))]))
    x = rng.normal(scale=0.5, size=len(codes))
    return Example(record, setup, (x, record[surfaces.RECORD.centre] + rng.normal(size=3)))


def control_point(rng: np.random.Generator) -> Example:
    """Return the control point with correlated coordinates."""
    a = rng.normal(size=(3, 3))
    w = control.whitening(a @ a.T + np.eye(3))
    return Example(control.POINT.pack(whitening=w.ravel(), place=rng.normal(size=3)), _NONE, (rng.normal(size=3),))


def relative_orientation(rng: np.random.Generator) -> Example:
    """Return the state of two images and one point."""
    start = random_rotation(rng)
    base, n_1, n_2 = np.linalg.qr(rng.normal(size=(3, 3)))[0].T
    record = coplanarity.RECORD.pack(
        factor=rng.uniform(0.5, 2.0), rotation=start.ravel(), base=base, n_1=n_1, n_2=n_2
    )  # fmt: skip
    return Example(record, _NONE, (rng.normal(scale=0.5, size=5), rng.uniform(-1.0, 1.0, 4)))


def similarity_point(rng: np.random.Generator) -> Example:
    """Return the point of a model and its control point."""
    start = random_rotation(rng)
    model, ground, whitening = rng.normal(size=3), rng.normal(size=3), rng.normal(size=9)
    record = similarity.RECORD.pack(model=model, place=ground, whitening=whitening, rotation=start.ravel(),
                                    scale=rng.uniform(0.5, 2.0), shift=rng.normal(size=3))  # fmt: skip
    return Example(record, _NONE, (rng.normal(scale=0.5, size=7),))


def curve_point(rng: np.random.Generator) -> Example:
    """Return the point near the middle of a segment of a straight line, or of a spline of four segments."""
    if rng.integers(2):
        setup = np.concatenate([rng.normal(size=6), np.zeros(6)])[None]
    else:
        x = np.arange(5.0)
        nodes = np.column_stack([2.0 * x, rng.normal(size=5), rng.normal(size=5)])
        setup = np.moveaxis(CubicSpline(x, nodes).c[::-1], 0, 1).reshape(4, 12)
    middle = curves.curve(setup[rng.integers(len(setup))], rng.uniform(0.3, 0.7))[0]
    record = curves.RECORD.pack(axis=rng.normal(size=3), sigma=rng.uniform(0.5, 2.0, 2))
    return Example(record, setup, (middle + rng.normal(scale=0.05, size=3),))


def _simple(record: Callable[[np.random.Generator], Array], *sizes: int) -> Callable[[np.random.Generator], Example]:
    """Return the state with normal unknowns of these sizes."""
    return lambda rng: Example(record(rng), _NONE, tuple(rng.normal(size=n) for n in sizes))


def _factors(n: int) -> Callable[[np.random.Generator], Array]:
    return lambda rng: rng.uniform(0.5, 2.0, n)


#: Function that draws a state, by the name of the equation.
EXAMPLES: dict[str, Callable[[np.random.Generator], Example]] = {
    "look_angle_collinearity": look_angle_collinearity,
    "frame_angles": frame_angles_collinearity,
    "frame_collinearity": frame_collinearity,
    "frame_extended": frame_extended_collinearity,
    "rational_function": rational_function,
    "dlt_brown_measured_to_ideal": dlt,
    "plane_polynomial": plane_transformation(0),
    "plane_helmert": plane_transformation(4),
    "plane_projective": plane_transformation(6, 2),
    "affine_projection": plane_transformation(8),
    "parallel_projection": plane_transformation(8, 1),
    "line_scanner_dlt": plane_transformation(8, 3),
    "control_point": control_point,
    "curve_control": curve_point,
    "latitudinal_point": latitudinal_point,
    "height_control": _simple(lambda rng: rng.normal(size=control.HEIGHT.size), 3),
    "antenna_position": antenna_position,
    "inertial_attitude": inertial_attitude,
    "coplanarity": relative_orientation,
    "similarity": similarity_point,
    "constraint_distance": _simple(_factors(2), 3, 3),
    "constraint_parallel": _simple(lambda rng: _figure(rng)[: constraints.DIRECTION.size], 3, 3, 3, 3),
    "constraint_perpendicular": _simple(_factors(1), 3, 3, 3, 3),
    "constraint_equal": _simple(_factors(1), 3, 3, 3, 3),
    "constraint_plane": lambda rng: Example(_figure(rng), _NONE, (rng.normal(scale=0.2, size=3), rng.normal(size=3))),
    "constraint_line": lambda rng: Example(_figure(rng), _NONE, (rng.normal(scale=0.2, size=4), rng.normal(size=3))),
    "constraint_plumb_line": _simple(_factors(1), 2, 3),
    "constraint_circle": circle,
    "constraint_horizontal_circle": _simple(_factors(1), 4, 3),
    "constraint_equal_attitude": equal_attitude,
    "observed_element": _simple(lambda rng: np.append(rng.uniform(0.5, 2.0, 2), rng.integers(0, 4)), 4),
    "surface_sphere": _simple(_factors(1), 4, 3),
    "surface_ellipsoid": ellipsoid,
    "surface_quadric": _simple(_factors(1), 10, 3),
}


def example(equation: Equation, rng: np.random.Generator) -> Example:
    """Draw a state of an equation."""
    return EXAMPLES[equation.name](rng)
