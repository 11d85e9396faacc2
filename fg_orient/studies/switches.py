"""Switches between the published equations and the procedure of the authors' program.

The program (public, 2013) departs from the equations of Topan & Maktav (2010) and Terlemezoğlu (2019) in the points
below; D8 is inferred from its numbers. Each is a switch of its own, so that its effect can be shown alone
(docs/program-as-run.md): ``TEXT`` has none of them, ``PROGRAM`` all. The labels D1 to D8 are those of that page.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, fields, replace
from typing import Final


def _switch(label: str, source: str) -> bool:
    """A switch, off, with its label and its source."""
    return field(default=False, metadata={"label": label, "source": source})


@dataclass(frozen=True)
class Switches:
    """Departures of the program from the equations; the default is none.

    Parameters
    ----------
    centred_lines : bool
        D1. x of the coefficients counts from the scene-centre line (-6000 to 6000), not from the first line.
    midpoint : bool
        D2. Two rays are intersected at the middle of their shortest connection, not at its end on the first ray.
    line_exact : bool
        D3. Step 1, the misclosures of the first step-2 and bundle iterations, and the intersections without EOP
        corrections use orbit and attitude interpolated at the line; A, later misclosures and all other
        intersections the degree-2 polynomials. Off: polynomials everywhere.
    test_after : bool
        D4. Step 1 tests its conditions after the correction, not before it: one cycle less.
    length_follows : bool
        D5. The length s of the across-track axis follows the EOP unknowns; off: it stays at the metadata.
    metadata_misclosures : bool
        D6. Misclosures of the first iteration of the type-2 bundle are those of the metadata EOPs, although A and
        the check points are those of the EOPs of step 2.
    one_limit : bool
        D7. Step 2 repeats while a correction exceeds one number for all unknowns: 10 in the units of the unknowns,
        10" for sets of attitudes only; at most 1000 times. Off: 10 m, 10 m/s or 10" by unknown, at most 10 times.
    look_quotients : bool
        D8. The derivatives of f1/f3 and f2/f3 in A take these quotients from the look angles: (df1 - tan psi_y
        df3)/f3. Where a condition is not met, at the check points, A differs by the misclosure, 1e-5.
    short_axis : bool
        The across-track axis is V/|V| x Z, which is not a unit vector, and the matrix is inverted by transposing it.
    small_angles : bool
        The attitude matrix is I + [a]x, inverted by transposing it.
    coarse_stop : bool
        Step 1 ends at 0.1" instead of at rounding.
    repeated_step_2 : bool
        Step 2 repeats while corrections are large and A has full rank; off: one iteration.
    metadata_positions : bool
        Control points are intersected again from the metadata positions with the corrected rotations.
    complex_roots : bool
        Square roots of negative numbers are complex, and the real part of the result is taken.
    """

    centred_lines: bool = _switch("D1", "program: image line minus scene-centre line")
    midpoint: bool = _switch("D2", "program: least squares for both ranges, then the mean of both points")
    line_exact: bool = _switch("D3", "program: Lagrange and linear attitude in w, polynomials in A (T-Table 4.1)")
    test_after: bool = _switch("D4", "program: step 1 corrects, then tests")
    length_follows: bool = _switch("D5", "program: derivatives of V/|V| x Z as written")
    metadata_misclosures: bool = _switch("D6", "program: w of the bundle at the metadata EOPs, type 2")
    one_limit: bool = _switch("D7", "program: one number for all unknowns of step 2")
    look_quotients: bool = _switch("D8", "inferred: the program's numbers of sets 14 to 16 and 18 fit with it alone")
    short_axis: bool = _switch("short axis", "program: V/|V| x Z without normalising it again")
    small_angles: bool = _switch("small angles", "T(2.24), P(4), transposed as inverse")
    coarse_stop: bool = _switch('0.1"', "program: limit of step 1")
    repeated_step_2: bool = _switch("repeats", "program: loop of step 2, ended by rank(A) < u")
    metadata_positions: bool = _switch("positions", "program: centres of the control points' new intersection")
    complex_roots: bool = _switch("complex", "program: square roots of its language")

    def without(self, *names: str) -> Switches:
        """Give these switches with some of them off."""
        return replace(self, **dict.fromkeys(names, False))

    def with_(self, *names: str) -> Switches:
        """Give these switches with some of them on."""
        return replace(self, **dict.fromkeys(names, True))


def names(which: Iterable[str] | None = None) -> tuple[str, ...]:
    """Names of the switches with these labels; all without labels."""
    chosen = None if which is None else set(which)
    return tuple(f.name for f in fields(Switches) if chosen is None or f.metadata["label"] in chosen)


def label(name: str) -> str:
    """Label of a switch in tables: "D1" to "D8", "short axis" ..."""
    return str(next(f.metadata["label"] for f in fields(Switches) if f.name == name))


def source(name: str) -> str:
    """Source of a switch."""
    return str(next(f.metadata["source"] for f in fields(Switches) if f.name == name))


#: The published equations.
TEXT: Final = Switches()
#: The program.
PROGRAM: Final = TEXT.with_(*names())
#: D1 to D8.
NUMBERED: Final = names(f"D{k}" for k in range(1, 9))


def switches_of(as_run: bool | Switches) -> Switches:
    """Switches of an option that may be a plain yes or no."""
    return as_run if isinstance(as_run, Switches) else PROGRAM if as_run else TEXT
