"""The authors' program: switches between its procedure and the published equations, and its own equations.

The program (public, 2013) differs from the equations of Topan & Maktav (2010) and Terlemezoğlu (2019) in the points
below; D8 is inferred from its numbers. Each difference has its own switch, so that its effect can be shown separately
(docs/program-as-run.md, which uses the same labels D1 to D8): ``TEXT`` has no differences, ``PROGRAM`` has all.

Equations that differ from the kernel: the program takes ``X = V/|V| x Z`` without normalisation, and ``Y = Z x X``:
both have the length ``s = sin(V, Z)``. With the orthonormal frame R, ``D = diag(s, s, 1)``, attitude U and mounting M0
its ray is ``R D U M0 u1``, and its conditions use ``f = M0^T U^T D R^T w``. The kernel gives these values with the
mounting ``M = U^-1 D U M0``, because ``U M = D U M0``. Derivatives of f are computed by complex steps, which are exact
to rounding.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Final

import numpy as np

from factors.arrays import Array, Mask
from factors.geometry import rotations


def _switch(label: str) -> bool:
    """A switch, off, with its label in tables."""
    return field(default=False, metadata={"label": label})


@dataclass(frozen=True)
class Switches:
    """Differences of the program from the equations; by default there are none.

    Parameters
    ----------
    centred_lines : bool
        D1. x of the coefficients counts from the scene-centre line (-6000 to 6000), not from the first line.
    midpoint : bool
        D2. The intersection of two rays is the middle of their shortest connection (least squares for both ranges, then
        the mean of both points), not its foot point on the first ray.
    line_exact : bool
        D3. Orbit and attitude are interpolated at the line in step 1, in the misclosures of the first step-2 and bundle
        iterations and in the intersections without EOP corrections. A, later misclosures and all other intersections
        use the degree-2 polynomials (T-Table 4.1). Off: polynomials everywhere.
    test_after : bool
        D4. Step 1 tests its conditions after the correction, not before it: one cycle less.
    length_follows : bool
        D5. The length s of the across-track axis follows the EOP unknowns (derivatives of V/|V| x Z as written). Off:
        the length of the metadata.
    metadata_misclosures : bool
        D6. Misclosures of the first iteration of the type-2 bundle belong to the metadata EOPs, although A and
        the check points belong to the EOPs of step 2.
    one_limit : bool
        D7. Step 2 repeats while a correction exceeds one number for all unknowns: 10 in the units of the unknowns,
        10" for sets of attitudes only; at most 1000 times. Off: 10 m, 10 m/s or 10" by unknown, at most 10 times.
    look_quotients : bool
        D8. The derivatives of f1/f3 and f2/f3 in A take these quotients from the look angles: (df1 - tan psi_y
        df3)/f3. Where a condition is not met, at the check points, A differs by the misclosure, 1e-5. Inferred: only
        with this switch the program's numbers of sets 14 to 16 and 18 are reproduced.
    short_axis : bool
        The across-track axis is V/|V| x Z without normalisation, and the matrix is inverted by transposing it.
    small_angles : bool
        The attitude matrix is I + [a]x, inverted by transposing it (T(2.24), P(4)).
    coarse_stop : bool
        Step 1 ends at 0.1", not at rounding.
    repeated_step_2 : bool
        Step 2 repeats while corrections are large and A has full rank. Off: one iteration.
    metadata_positions : bool
        Control points are intersected again from the metadata positions with the corrected rotations.
    complex_roots : bool
        Square roots of negative numbers are complex, and the result is its real part.
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
        """These switches with some of them off."""
        return replace(self, **dict.fromkeys(names, False))

    def with_(self, *names: str) -> Switches:
        """These switches with some of them on."""
        return replace(self, **dict.fromkeys(names, True))


def names(which: Iterable[str] | None = None) -> tuple[str, ...]:
    """Names of the switches with these labels; all without labels."""
    chosen = None if which is None else set(which)
    return tuple(f.name for f in fields(Switches) if chosen is None or f.metadata["label"] in chosen)


def label(name: str) -> str:
    """Label of a switch in tables: "D1" to "D8", "short axis" ..."""
    return str(next(f.metadata["label"] for f in fields(Switches) if f.name == name))


#: The published equations.
TEXT: Final = Switches()
#: The program.
PROGRAM: Final = TEXT.with_(*names())
#: D1 to D8.
NUMBERED: Final = names(f"D{k}" for k in range(1, 9))


def switches_of(as_run: bool | Switches) -> Switches:
    """Switches of an option that may be True or False."""
    return as_run if isinstance(as_run, Switches) else PROGRAM if as_run else TEXT


_STEP: Final = 1e-30


@dataclass(frozen=True)
class States:
    """Corrected EOPs of n image points.

    Parameters
    ----------
    metadata_position_m, position_m : (n, 3) arrays
        Without and with corrections.
    frame_position_m, frame_velocity_m_s : (n, 3) arrays
        Position and velocity that define the orbital frame; the frame of DIMAP 2 files does not follow corrections.
    angles_rad : (n, 3) array
        Roll, pitch, yaw.
    mounting : (n, 9) array
        Mounting for the kernel.
    small : bool
        Form of the attitude.
    follows : (n,) bool array
        Whether the frame follows the corrections.
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
    """``M = U^-1 D U M0`` of n states: (n, 9) from (n, 3) P, V, angles and (n, 9) M0."""
    u = rotations.attitude_matrices(np.ascontiguousarray(angles), small)
    d = np.ones((len(p), 3, 1))
    d[:, :2, 0] = axis_length(p, v)
    return np.asarray((np.linalg.solve(u, d * u) @ base.reshape(-1, 3, 3)).reshape(-1, 9))


def axis_length(p: Any, v: Any) -> Any:
    """Length s = sin(V, Z) of the across-track axis (n, 1), real or complex."""
    return _length(np.cross(v, p)) / (_length(v) * _length(p))


def _length(a: Any) -> Any:
    """Length without conjugation (n, 1): analytic."""
    return np.sqrt(np.sum(a * a, axis=1, keepdims=True))


def _rotated(p: Any, v: Any, angles: Any, to_ground: Any, base: Array, small: bool, s: Any) -> Any:
    """``f = M0^T U^T D R^T w`` (n, 3); D = 1 for s = 1."""
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
    at: States, base: Array, to_ground: Array, components: Sequence[int], *, short: bool,
    tangents: Array | None,
) -> Array:  # fmt: skip
    """Derivatives of both conditions by EOPs.

    Parameters
    ----------
    at : States
    base : (n, 9) array
        M0.
    to_ground : (n, 3) array
        Ground point minus P, ECEF.
    components : sequence of k int
        Positions among the nine EOPs.
    short : bool
        The axis is short, and its length follows the unknowns.
    tangents : (n, 2) array or None
        Quotients f1/f3 and f2/f3 in the derivative of a quotient; None computes them from f.

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
