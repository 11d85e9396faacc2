"""Differences between the authors' program and the published equations, as switches, and the program's own equations.

The program (public, 2013) differs from the equations of Topan & Maktav (2010) and Terlemezoğlu (2019) in the points
below. D8 is inferred from the numbers of the program. Each difference has its own switch, so that its
effect can be shown separately; docs/program-as-run.md uses the same labels D1 to D8. ``TEXT`` has no
differences, ``PROGRAM`` has all.

Some equations differ from the kernel. The program computes ``X = V/|V| x Z`` without normalisation, and ``Y = Z x X``,
so both have the length ``s = sin(V, Z)``. With the orthonormal frame R, ``D = diag(s, s, 1)``, attitude U and mounting
M0 its ray is ``R D U M0 u1``, and its conditions use ``f = M0^T U^T D R^T w``. The kernel gives these values with the
mounting ``M = U^-1 D U M0``, because ``U M = D U M0``. Derivatives of f are computed by complex steps, which are exact
up to rounding.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Final

import numpy as np

from factors.arrays import Array, Mask
from factors.geometry import rotations


def _switch(label: str) -> bool:
    """Declare a switch that is off by default, with its label in tables."""
    return field(default=False, metadata={"label": label})


@dataclass(frozen=True)
class Switches:
    """Differences of the program from the equations; none by default.

    Parameters
    ----------
    centred_lines : bool
        D1. x of the coefficients counts from the scene-centre line (-6000 to 6000), not from the first line.
    midpoint : bool
        D2. The intersection of two rays is the middle of their shortest connection (least squares for both ranges, then
        the mean of both points). Off: the foot point of this connection on the first ray.
    line_exact : bool
        D3. Orbit and attitude are interpolated at the line in step 1, in the misclosures of the first iterations of
        step 2 and bundle, and in intersections without EOP corrections. A, later misclosures and all other
        intersections use the degree-2 polynomials (T-Table 4.1). Off: polynomials everywhere.
    test_after : bool
        D4. Step 1 tests its conditions after the correction, not before it, which saves one cycle.
    length_follows : bool
        D5. The length s of the across-track axis follows the EOP unknowns (derivatives of V/|V| x Z as written). Off:
        it has the length given by the metadata.
    metadata_misclosures : bool
        D6. Misclosures of the first iteration of the type-2 bundle use the metadata EOPs, although A and the check
        points use the EOPs of step 2.
    one_limit : bool
        D7. Step 2 repeats while a correction exceeds one number for all unknowns, at most 1000 times. The number is 10
        in the units of the unknowns, 10" for sets of attitudes only. Off: 10 m, 10 m/s or 10" by unknown, at most 10
        times.
    look_quotients : bool
        D8. The derivatives of f1/f3 and f2/f3 in A take these quotients from the look angles: (df1 - tan psi_y df3)/f3.
        Check points do not meet the conditions; there A differs by the misclosure, 1e-5. Inferred: only with this
        switch the program's numbers of sets 14 to 16 and 18 are reproduced.
    short_axis : bool
        The across-track axis is V/|V| x Z without normalisation; its matrix is inverted by transposing.
    small_angles : bool
        The attitude matrix is I + [a]x, inverted by transposing (T(2.24), P(4)).
    coarse_stop : bool
        Step 1 ends at 0.1", not at the level of rounding.
    repeated_step_2 : bool
        Step 2 repeats while corrections are large and A has full rank. Off: one iteration.
    metadata_positions : bool
        Control points are intersected again from the metadata positions with the corrected rotations.
    complex_roots : bool
        Square roots of negative numbers are complex, and only the real part of the result is used.
    """

    centred_lines: bool = _switch("D1")
    midpoint: bool = _switch("D2")
    line_exact: bool = _switch("D3")
    test_after: bool = _switch("D4")
    length_follows: bool = _switch("D5")
    metadata_misclosures: bool = _switch("D6")
    one_limit: bool = _switch("D7")
    look_quotients: bool = _switch("D8")
    short_axis: bool = _switch("short axis")
    small_angles: bool = _switch("small angles")
    coarse_stop: bool = _switch('0.1"')
    repeated_step_2: bool = _switch("repeats")
    metadata_positions: bool = _switch("positions")
    complex_roots: bool = _switch("complex")

    def without(self, *names: str) -> Switches:
        """Return these switches with some of them off."""
        return replace(self, **dict.fromkeys(names, False))

    def with_(self, *names: str) -> Switches:
        """Return these switches with some of them on."""
        return replace(self, **dict.fromkeys(names, True))


def names(which: Iterable[str] | None = None) -> tuple[str, ...]:
    """Return the names of the switches with these labels; without labels the names of all."""
    chosen = None if which is None else set(which)
    return tuple(f.name for f in fields(Switches) if chosen is None or f.metadata["label"] in chosen)


def label(name: str) -> str:
    """Return the label of a switch in tables: "D1" to "D8", "short axis" ..."""
    return str(next(f.metadata["label"] for f in fields(Switches) if f.name == name))


#: Published equations: no differences.
TEXT: Final = Switches()
#: Authors' program: all differences.
PROGRAM: Final = TEXT.with_(*names())
#: Names of the switches D1 to D8.
NUMBERED: Final = names(f"D{k}" for k in range(1, 9))


def switches_of(as_run: bool | Switches) -> Switches:
    """Return the switches for an option that may be True or False."""
    return as_run if isinstance(as_run, Switches) else PROGRAM if as_run else TEXT


_STEP: Final = 1e-30


@dataclass(frozen=True)
class States:
    """Corrected EOPs of n image points.

    Parameters
    ----------
    metadata_position_m, position_m : (n, 3) arrays
        Positions without and with corrections.
    frame_position_m, frame_velocity_m_s : (n, 3) arrays
        Position and velocity that define the orbital frame; in DIMAP 2 files the frame does not follow corrections.
    angles_rad : (n, 3) array
        Roll, pitch, yaw.
    mounting : (n, 9) array
        Mounting for the kernel.
    small : bool
        True if the attitude has the small-angle form.
    follows : (n,) bool array
        True if the frame follows the corrections.
    """

    metadata_position_m: Array
    position_m: Array
    frame_position_m: Array
    frame_velocity_m_s: Array
    angles_rad: Array
    mounting: Array
    small: bool
    follows: Mask


def mounting(p: Array, v: Array, angles: Array, base: Array, small: bool) -> Array:
    """Return ``M = U^-1 D U M0`` of n states: (n, 9) from (n, 3) P, V, angles and (n, 9) M0."""
    u = rotations.attitude_matrices(np.ascontiguousarray(angles), small)
    d = np.ones((len(p), 3, 1))
    d[:, :2, 0] = axis_length(p, v)
    return np.asarray((np.linalg.solve(u, d * u) @ base.reshape(-1, 3, 3)).reshape(-1, 9))


def axis_length(p: Any, v: Any) -> Any:
    """Return the length s = sin(V, Z) of the across-track axis (n, 1), real or complex."""
    return _length(np.cross(v, p)) / (_length(v) * _length(p))


def _length(a: Any) -> Any:
    """Return the length (n, 1) without complex conjugation, so that the function is analytic."""
    return np.sqrt(np.sum(a * a, axis=1, keepdims=True))


def _rotated(p: Any, v: Any, angles: Any, to_ground: Any, base: Array, small: bool, s: Any) -> Any:
    """Return ``f = M0^T U^T D R^T w`` (n, 3); D = 1 for s = 1."""
    z = p / _length(p)
    x = np.cross(v, z)
    x = x / _length(x)
    y = np.cross(z, x)
    w = np.stack([np.sum(axis * to_ground, axis=1) for axis in (x, y, z)])
    w[:2] *= s[:, 0]
    roll, pitch, yaw = angles.T
    if small:
        u = rotations.orbital_from_body_small(roll, pitch, yaw)
    else:
        sines = [f(a) for a in (roll, pitch, yaw) for f in (np.sin, np.cos)]
        u = rotations.from_sines(*sines)
    f = np.stack(rotations.multiply_transposed(u, w), axis=1)
    return np.einsum("nji,nj->ni", base.reshape(-1, 3, 3), f)


def derivatives(
    at: States,
    base: Array,
    to_ground: Array,
    components: Sequence[int],
    *,
    short: bool,
    tangents: Array | None,
) -> Array:
    """Return the derivatives of both conditions by the EOPs.

    Parameters
    ----------
    at : States
    base : (n, 9) array
        Mounting M0.
    to_ground : (n, 3) array
        Ground point minus P, ECEF.
    components : sequence of k int
        Positions among the nine EOPs.
    short : bool
        True if the axis is short and its length follows the unknowns.
    tangents : (n, 2) array or None
        Quotients f1/f3 and f2/f3 used in the derivative of a quotient; None computes them from f.

    Returns
    -------
    (n, 2, k) array
    """
    n, k = len(to_ground), len(components)
    given = np.hstack([at.frame_position_m, at.frame_velocity_m_s, at.angles_rad, to_ground])
    moved = np.tile(given.astype(complex), (k, 1, 1))  # one copy of all points for each step
    follows = at.follows.astype(float)
    for step, component in enumerate(components):
        moved[step, :, component] += 1j * _STEP * (follows if component < 6 else 1.0)
        if component < 3:
            moved[step, :, 9 + component] -= 1j * _STEP
    p, v, angles, w = (np.ascontiguousarray(moved[:, :, 3 * c : 3 * c + 3].reshape(-1, 3)) for c in range(4))
    s = axis_length(p, v) if short else np.ones((len(p), 1))
    steps = _rotated(p, v, angles, w, np.tile(base, (k, 1)), at.small, s).reshape(k, n, 3)
    f, df = steps[-1].real, np.moveaxis(steps.imag / _STEP, 0, 2)
    q = f[:, :2] / f[:, 2:] if tangents is None else tangents
    return np.asarray((df[:, :2] - q[:, :, None] * df[:, 2:]) / f[:, 2:, None])
