"""Direct linear transformation: 11 parameters and distortion, interior and exterior orientation recovered from them.

Control points are refused if their heights above a plane are within the noise of the
image. Let the middle of the points be the origin and their plane Z = 0. A photo of the
plane alone is a homography. Its eight parameters do not determine the third column (L3,
L7, L11) of the matrix. If the heights are too small, noise determines this column. With
columns m1, m2, m3, m4 the projection centre has the height ``-D4 / D3``, ``D3 = det(m1,
m2, m3)`` and ``D4 = det(m1, m2, m4)``. Noise in the third column moves the centre through
1 / ``D3``. ``D3`` is the determinant of the left part of the matrix in any axes, so the
plane need not be known. It is also 0 for a parallel projection.

A test that ``D3`` differs from 0 by q sigmas (q: quantile of ``LEVEL``) is not
sufficient, because error propagation to the inverse of a number is valid only many sigmas
from 0. If the estimate is T sigmas from 0 and the true value is t, the error of the
centre is ``T (T - t) / t`` standard deviations. This error may exceed ``ALLOWED`` only if
the noise exceeds q: T - t >= q at ``T (T - t) / t = ALLOWED`` requires ``T >= q ALLOWED /
(ALLOWED - q)``, 8.1 = 2.6 q for known sigmas. If m0 replaces unknown sigmas, q is
Student's quantile, at most ``ALLOWED``. With a redundancy below 7, errors of good
coordinates exceed this limit more often than ``LEVEL``. With a redundancy of 1, one flat
set of 15 passes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from factors.cameras.dlt import DLT, N_DISTORTION, RECORD
from factors.cameras.image_corrections import NAMES
from fg_orient.closerange import fitting
from fg_orient.closerange.photo import Photo, YAxis, corrections_of
from fg_orient.model.arrays import array
from fg_orient.model.distributions import normal_quantile, t_quantile
from fg_orient.model.errors import Finding, InputError, NoSolutionError, finding
from fg_orient.rectification.transformation import Scaling

#: Distortion coefficients that a DLT may have, in their order.
DISTORTION: Final = NAMES[:N_DISTORTION]
PARAMETERS: Final = tuple(f"L{k}" for k in range(1, 12))
RECOVERED: Final = ("x0", "y0", "cx", "cy", "skew", "X0", "Y0", "Z0", "turn_x", "turn_y", "turn_z")
#: The points are coplanar if the ratio of the smallest to the largest singular value of the
#: scaled design is below this.
PLANE_LIMIT: Final = 1e-7
#: A refusal calls the points "close to a plane" if the ratio of the third to the first
#: singular value of the centred points is at most this.
CLOSE_TO_PLANE: Final = 0.1
#: The search for the centre of the distortion ends if it moves by less than this, relative to the extent of the image.
SETTLED: Final = 1e-9
_STEP: Final = 1e-30
#: Probability that the error of a projection centre exceeds ``ALLOWED`` standard deviations.
LEVEL: Final = 1e-3
ALLOWED: Final = 5.0


@dataclass(frozen=True)
class Recovered:
    """Interior and exterior orientation of a DLT (Ayhan 1996, eq. 43).

    Parameters
    ----------
    principal : (2,) array
    cx, cy : float
        Principal distances along x and y.
    skew : float
        Deviation of the image axes from a right angle, rad.
    centre_m : (3,) array
    rotation : (3, 3) array
        Camera axes X right, Y down, Z along the view, from ground axes; Y follows the y
        axis of the image exactly.
    y_axis : "up" or "down"
        Direction of y in the image, computed from the points.
    sigma : dict or None
        Standard deviations by name (:data:`RECOVERED`; rotations about the camera axes,
        rad); None without redundancy.
    """

    principal: Array
    cx: float
    cy: float
    skew: float
    centre_m: Array
    rotation: Array
    y_axis: YAxis
    sigma: dict[str, float] | None


@dataclass(frozen=True)
class DltFit(fitting.Fit):
    """Adjusted DLT.

    Parameters
    ----------
    photo : Photo
        Photo whose matrix contains L1 to L11 and 1, for ground coordinates relative to ``photo.origin_m``.
    names : tuple of str
        L1 to L11 and the distortion coefficients, in the unit of the image coordinates.
    values : (u,) array
    residuals : (n, 2) array
        Computed minus corrected image coordinates.
    recovered : Recovered
    doubt : Finding or None
        Warning: standard deviations are too small, because the projection is hardly central.
    """

    photo: Photo
    names: tuple[str, ...]
    values: Array
    residuals: Array
    recovered: Recovered
    doubt: Finding | None = None


def direct_dlt(ground: Array, image: Array) -> Array:
    """Return L1 to L11 by linear least squares of the equations times their denominator (Ayhan 1996, eq. 38).

    Ground (n, 3) and image (n, 2) coordinates are centred: at 1000 m the form with "+1" is nearly singular.
    """
    n = len(ground)
    design, right = np.zeros((2, n, 11)), image.T.copy()
    for row in range(2):
        design[row, :, 4 * row : 4 * row + 3], design[row, :, 4 * row + 3] = ground, 1.0
        design[row, :, 8:] = -image[:, row, None] * ground
    return np.asarray(np.linalg.lstsq(design.reshape(2 * n, 11), right.ravel(), rcond=None)[0])


def fit_dlt(
    ground_m: npt.ArrayLike,
    image: npt.ArrayLike,
    *,
    sigma: npt.ArrayLike | None = None,
    distortion: Sequence[str] = (),
    about: npt.ArrayLike | None = None,
    name: str = "",
    iterate: bool = True,
) -> DltFit:
    """Adjust a DLT.

    Parameters
    ----------
    ground_m : (n, 3) array
        Control points, m.
    image : (n, 2) array
        Measured x, y, any unit.
    sigma : float or array that fits (n, 2), optional
        Standard deviations of the image coordinates. By default all have weight 1, and m0 is their sigma.
    distortion : sequence of str
        Unknown coefficients among k1, k2, k3, p1, p2 (measured to ideal).
    about : (2,) array, optional
        Fixed origin of the distortion. Default: the principal point of L, found by
        iteration (of the direct solution, if the iteration does not converge).
    name : str
        Name of the photo.
    iterate : bool
        False: compute the direct linear solution (without distortion), in which the
        equations are multiplied by their denominator.

    Returns
    -------
    DltFit

    Raises
    ------
    InputError
        There are too few points; points lie in a plane, or are flat within the noise;
        coefficients are unknown; or values are impossible.
    NoSolutionError
        The iteration does not converge, or points lie on both sides of the camera.
    """
    ground = fitting.as_points(ground_m, 3, "ground")
    measured = fitting.as_points(image, 2, "image")
    size = fitting.as_sigmas(1.0 if sigma is None else sigma, measured)
    for unknown in [name for name in distortion if name not in DISTORTION or not iterate]:
        raise InputError.of("closerange.distortion", place="distortion", value=unknown, known=", ".join(DISTORTION))
    least = (11 + len(distortion) + 1) // 2
    if len(ground) != len(measured) or len(ground) < least:
        raise InputError.of("closerange.few", place="DLT", value=len(ground), least=least)
    codes = np.array([DISTORTION.index(name) for name in distortion], float)
    source, target = Scaling.of(ground, shared=True), Scaling.of(measured, shared=True)
    scale = target.scale / size
    records = RECORD.pack(
        source=source.normalised(ground),
        target=target.normalised(measured),
        w11=scale[:, 0],
        w12=0.0,
        w22=scale[:, 1],
        centre=np.zeros(2),
    )
    setup = np.ascontiguousarray(np.stack([codes, np.ones(len(codes))]))
    rows = fitting.equation_rows(DLT, records, setup)
    direct = direct_dlt(records[:, RECORD.source], records[:, RECORD.target])
    state, iterations = np.concatenate([direct, np.zeros(len(codes))]), 1
    _require_spatial(ground, rows(state, True)[1][:, :11])
    if len(codes):
        centre = (
            recover(direct, np.zeros(3)).principal if about is None else target.normalised(array(about, "about", (2,)))
        )
        records[:, RECORD.centre] = centre
    if iterate:
        state, iterations = _iterated(rows, records, state, moves=len(codes) > 0 and about is None)
    below = 1.0 + records[:, RECORD.source] @ state[8:11]
    if not (below > 0.0).all():
        raise NoSolutionError.of("closerange.behind", place=f"point {int(np.argmin(below)) + 1}")
    white, design = rows(state, True)
    assessed = _require_spatial(ground, design)
    # physical parameters are linear in the normalised ones because the last element of the matrix is 1
    to_physical = _denormalisation(source, target, distortion)
    facts = fitting.statistics(white, assessed, iterations, to_physical)
    doubt = require_depth(
        ground, state[:11], np.asarray(assessed.cofactors), facts["m0"], facts["redundancy"], known=sigma is not None
    )
    values, residuals = to_physical @ state, white.reshape(-1, 2) * size
    values[[3, 7]] += target.offset  # the last element of the matrix is 1
    recovered = _scaled(recover(values[:11], source.offset, facts["cofactors"][:11, :11]), facts["m0"], ground, size)
    origin = target.physical(records[0, RECORD.centre]) if distortion else recovered.principal
    photo = Photo(
        name, np.append(values[:11], 1.0).reshape(3, 4), source.offset, origin, corrections_of(distortion, values[11:])
    )
    return DltFit(photo, (*PARAMETERS, *distortion), values, residuals, recovered, doubt, **facts)


def _iterated(rows: fitting.Rows, records: Array, state: Array, *, moves: bool) -> tuple[Array, int]:
    """Return the adjusted state and number of iterations.

    If it ``moves``, the centre of distortion is the principal point of L. If this
    iteration does not converge (points that do not separate distortion and principal
    point), the centre of the direct solution is used; ``records`` contain the used
    centre.
    """
    start, before = records[0, RECORD.centre].copy(), np.inf
    first = last = fitting.adjust(rows, state, "DLT")
    iterations = len(last.log)
    while moves:
        centre = recover(last.state[:11], np.zeros(3)).principal
        shift = float(np.linalg.norm(centre - records[0, RECORD.centre]))
        if shift <= SETTLED:
            return last.state, iterations
        if not shift <= 0.5 * before:
            records[:, RECORD.centre] = start
            return first.state, iterations
        records[:, RECORD.centre], before = centre, shift
        last = fitting.adjust(rows, last.state, "DLT")
        iterations += len(last.log)
    return last.state, iterations


def _open(ground: Array, value: str) -> InputError:
    """Return the error for points close to a plane or in another critical configuration, such as a twisted cubic."""
    size = np.linalg.svd(ground - ground.mean(axis=0), compute_uv=False)
    code = "closerange.plane" if size[2] <= CLOSE_TO_PLANE * size[0] else "closerange.critical"
    return InputError.of(code, place="DLT", value=value)


def _require_spatial(ground: Array, design: Array) -> fitting.Determination:
    """Refuse points in a plane or another configuration that does not determine L."""
    assessed = fitting.determination(design)
    if assessed.cofactors is None or assessed.condition >= 1.0 / max(PLANE_LIMIT, fitting.RANK_LIMIT):
        raise _open(ground, f"condition {assessed.condition:.2g}")
    return assessed


def limits(redundancy: int, *, known: bool) -> tuple[float, float]:
    """Return two limits in sigmas: for a determinant that differs from 0, and for an inverse whose sigma is valid.

    ``known`` states whether sigmas were given. If not, ``redundancy`` must be at least 1.
    """
    normal = float(-normal_quantile(LEVEL))
    noise = normal if known else min(float(t_quantile(redundancy, 1.0 - LEVEL)), ALLOWED)
    return noise, noise * ALLOWED / (ALLOWED - normal)


def require_depth(
    ground: Array, parameters: Array, cofactors: Array, m0: float | None, redundancy: int, *, known: bool
) -> Finding | None:
    """Refuse points that are flat, or a projection that is parallel, within the noise; see the module docstring.

    Warn of a projection that is hardly central, whose centre has too small standard deviations.

    Parameters
    ----------
    ground : (n, 3) array
        Control points, m.
    parameters : (11,) array
        L1 to L11 for centred coordinates, in any unit.
    cofactors : (u, u) array
        Cofactors of these parameters and of the distortion coefficients.
    m0, redundancy
    known : bool
        True if sigmas were given; m0 can only enlarge them. Without them and without
        redundancy the noise is unknown, and nothing is refused.
    """
    if not known and m0 is None:
        return None
    unit = max(1.0, m0 or 0.0) if known else float(m0 or 0.0)
    matrix = np.append(parameters, 1.0).reshape(3, 4)[:, :3]
    slope = np.zeros((3, 4))
    slope[:, :3] = np.cross(matrix[[1, 2, 0]], matrix[[2, 0, 1]])  # derivatives of the determinant
    by_parameter = slope.ravel()[:11]
    deviation = unit * float(np.sqrt(np.maximum(by_parameter @ cofactors[:11, :11] @ by_parameter, 0.0)))
    determinant, (noise, honest) = abs(float(np.linalg.det(matrix))), limits(redundancy, known=known)
    if determinant >= honest * deviation:
        return None
    ratio, away = determinant / deviation, ground - ground.mean(axis=0)
    heights = np.linalg.svd(away, full_matrices=False)[2][2]
    pick = np.zeros((3, 3, 4))
    # with the heights as third axis, this gives the third column of the matrix
    pick[np.arange(3), np.arange(3), :3] = heights
    rows = pick.reshape(3, 12)[:, :11]
    both, own = cofactors[:11, 11:], cofactors[11:, 11:]
    given_distortion = cofactors[:11, :11] - both @ np.linalg.solve(own, both.T)
    column = rows @ parameters
    # effect of the heights in the image, in sigmas, if the distortion is known; its square has three degrees of freedom
    shown = float(np.sqrt(column @ np.linalg.solve(rows @ given_distortion @ rows.T, column))) / unit
    if shown < honest:
        rms = float(np.sqrt(np.mean((away @ heights) ** 2)))
        raise InputError.of(
            "closerange.flat",
            place="DLT",
            height=f"{rms:.2g} m",
            value=f"{ratio:.2g} sigmas from a plane, {honest:.3g} needed",
        )
    if ratio < noise:
        raise InputError.of(
            "closerange.parallel_noise", place="DLT", value=f"{ratio:.2g} sigmas from parallel, {noise:.3g} needed"
        )
    return finding("closerange.nearly_parallel", sigmas=ratio, honest=honest)


def _scaled(recovered: Recovered, m0: float | None, ground: Array, sigma: Array) -> Recovered:
    """Return the orientation with a posteriori standard deviations.

    Refused if its centre is 1000 times worse than a point.
    """
    apriori = recovered.sigma
    assert apriori is not None
    depth = float(np.linalg.norm(recovered.centre_m - ground.mean(axis=0)))
    worst = max(apriori[name] for name in ("X0", "Y0", "Z0"))
    ratio = worst / (float(np.sqrt(np.mean(sigma**2))) * depth / recovered.cx)
    if not ratio <= fitting.UNDETERMINED:
        raise _open(ground, f"projection centre {ratio:.2g} sigmas of a point")
    return replace(recovered, sigma=None if m0 is None else {name: m0 * s for name, s in apriori.items()})


def _denormalisation(source: Scaling, target: Scaling, distortion: Sequence[str]) -> Array:
    """Return the matrix (u, u) from normalised to physical parameters, with ground coordinates about the offset."""
    size, out = float(target.scale[0]), np.eye(11 + len(distortion))
    image = np.diag([size, size, 1.0])
    image[:2, 2] = target.offset
    ground = np.diag(np.append(1.0 / source.scale, 1.0))
    out[:11, :11] = np.kron(image, ground)[:11, :11]  # for the matrix (3, 4) row by row, without its last element
    for j, coefficient in enumerate(distortion, start=11):
        out[j, j] = size ** -({"k1": 2, "k2": 4, "k3": 6}.get(coefficient, 1))
    return out


def recover(parameters: Array, origin_m: Array, covariance: Array | None = None) -> Recovered:
    """Return the interior and exterior orientation from L1 to L11 (Ayhan 1996, eq. 43, with a corrected sign of omega).

    Parameters
    ----------
    parameters : (11,) array
        Parameters for ground coordinates relative to ``origin_m``.
    origin_m : (3,) array
    covariance : (11, 11) array, optional
        Covariance of the parameters. It is propagated to standard deviations by complex
        steps through the same formulas.

    Raises
    ------
    NoSolutionError
        L9 to L11 are 0 (parallel projection), or the projection is degenerate.
    """
    matrix = np.append(parameters, 1.0).reshape(3, 4)
    sign = float(np.sign(np.linalg.det(matrix[:, :3])))
    with np.errstate(all="ignore"):
        values, rotation = _orientation(matrix, sign) if abs(sign) == 1.0 else (np.array(np.nan), np.array(np.nan))
    if not (np.isfinite(values).all() and np.isfinite(rotation).all()):
        raise NoSolutionError.of("closerange.parallel", place="DLT")
    sigma = None
    if covariance is not None:
        slopes = np.zeros((len(RECOVERED), 11))
        for k in range(11):
            stepped = matrix.astype(complex)
            stepped.flat[k] += 1j * _STEP
            moved, turned = _orientation(stepped, sign)
            spin = turned.imag / _STEP @ rotation.real.T  # [w]x of the rotation about the camera axes
            slopes[:8, k], slopes[8:, k] = moved.imag / _STEP, (spin[2, 1], spin[0, 2], spin[1, 0])
        variance = np.einsum("ij,jk,ik->i", slopes, covariance, slopes)
        sigma = dict(zip(RECOVERED, np.sqrt(np.maximum(variance, 0.0)).tolist(), strict=True))
    x0, y0, cx, cy, skew = values.real[:5].tolist()
    return Recovered(np.array([x0, y0]), cx, cy, skew, values.real[5:] + origin_m, rotation.real,
                     "down" if sign > 0.0 else "up", sigma)  # fmt: skip


def _orientation(matrix: npt.NDArray[Any], sign: float) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Return x0, y0, cx, cy, skew, centre (8,) and rotation (3, 3).

    Complex matrices are allowed.
    """
    m = matrix[:, :3] / np.sqrt(np.sum(matrix[2, :3] ** 2))
    x0, y0 = m[0] @ m[2], m[1] @ m[2]
    along_x, along_y = m[0] - x0 * m[2], m[1] - y0 * m[2]
    cx, cy = np.sqrt(np.sum(along_x**2)), np.sqrt(np.sum(along_y**2))
    down = sign * along_y / cy
    rotation = np.stack([np.cross(down, m[2]), down, m[2]])
    skew = np.arcsin((along_x / cx) @ down)
    centre = -np.linalg.solve(matrix[:, :3], matrix[:, 3])
    return np.concatenate([[x0, y0, cx, cy, skew], centre]), rotation
