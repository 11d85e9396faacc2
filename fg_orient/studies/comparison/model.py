"""Comparison of EOP sets, solvers and backends: rows, singular values, directions, L-curves, and its selections."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from importlib.util import find_spec
from typing import Any, Final, TypeVar

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.linear import registry
from fg_orient.adjustment.linear.l_curve import Choice, LCurve
from fg_orient.model.block import Block
from fg_orient.model.errors import InputError
from fg_orient.model.parameters import eop_set_number

BACKENDS: Final = ("faithful", "dense", "graph")
TYPES: Final = (1, 2)
#: Name of the graph backend's solver in the tables.
GRAPH_SOLVER: Final = "gtsam"
AXES: Final = ("x", "y", "z")
#: A singular value below eps times the largest is rounding: this condition number of N means "at least this".
LARGEST_CONDITION: Final = float(np.finfo(float).eps ** -2)
_NAN: Final = float("nan")


@dataclass(frozen=True)
class Row:
    """One adjustment of the comparison; missing numbers are nan or None.

    Parameters
    ----------
    eop_set, eop_set_name : int, str
    solver : str
        Name in the registry of ``fg_orient.adjustment.linear``; "gtsam" for the graph.
    backend : "faithful", "dense" or "graph"
    type : int or None
        Pre-adjustment of the published procedure: 1 look angles, 2 look angles and EOPs.
    control_rmse_m, check_rmse_m : float
        Largest of the three ECEF axes, as published (Terlemezoğlu 2019, eq. 2.72); nan without points.
    control_rmse_x_m ... check_rmse_z_m : float
        The axes.
    cond_raw, cond_scaled : float
        Condition number of ``N = A^T A`` as the square of A's: unknowns in m, m/s, rad; columns of A of
        unit length. At most :data:`LARGEST_CONDITION`.
    rank, order : int or None
        Numerical rank of A in raw units, and the number of unknowns.
    kappa : float
        Regularisation parameter, for Tikhonov solvers of the published procedure.
    sigma0 : float
        A posteriori standard deviation of unit weight; nan for the published procedure.
    m0_rad : float
        ``sqrt(v^T v / redundancy)`` of the look angles, for the published procedure.
    iterations : int
    seconds : float
        Wall-clock time of this adjustment, without statistics if they are timed separately.
    reached : bool
        Both RMSE are at most the target (control points alone without check points).
    difference_sigmas, difference_m : float
        Dense minus graph: largest difference of an orientation unknown in prior sigmas, and of a
        coordinate of a ground point; nan if one of the two solutions is missing.
    failure : str
        Reason for a missing solution; "" if there is one.
    left_out : bool
        The adjustment was not tried; ``failure`` is the reason.
    notes : tuple of str
        Remarks of the solver.
    """

    eop_set: int
    eop_set_name: str
    solver: str
    backend: str
    type: int | None = None
    control_rmse_m: float = _NAN
    check_rmse_m: float = _NAN
    control_rmse_x_m: float = _NAN
    control_rmse_y_m: float = _NAN
    control_rmse_z_m: float = _NAN
    check_rmse_x_m: float = _NAN
    check_rmse_y_m: float = _NAN
    check_rmse_z_m: float = _NAN
    cond_raw: float = _NAN
    cond_scaled: float = _NAN
    rank: int | None = None
    order: int | None = None
    kappa: float = _NAN
    sigma0: float = _NAN
    m0_rad: float = _NAN
    iterations: int = 0
    seconds: float = _NAN
    reached: bool = False
    difference_sigmas: float = _NAN
    difference_m: float = _NAN
    failure: str = ""
    left_out: bool = False
    notes: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Columns by name."""
        return asdict(self) | {"notes": "; ".join(self.notes)}


COLUMNS: Final = tuple(f.name for f in fields(Row))


@dataclass(frozen=True)
class Spectrum:
    """Singular values of one design matrix A, in descending order.

    Parameters
    ----------
    eop_set : int
    system : str
        "published 1", "published 2" (bundle after the pre-adjustment of type 1, 2), "adjustment" (of
        :func:`fg_orient.adjust`, priors included) or "no priors" (the same without its priors).
    scaling : str
        "raw" (m, m/s, rad), "columns" (unit length) or "priors" (unknowns in prior sigmas, as solved).
    values : (u,) array
    """

    eop_set: int
    system: str
    scaling: str
    values: Array

    @property
    def condition(self) -> float:
        """Condition number of ``N = A^T A``: the square of A's, at most :data:`LARGEST_CONDITION`."""
        smallest = max(float(self.values[-1]), float(self.values[0]) * np.finfo(float).eps)
        return min(float((self.values[0] / smallest) ** 2), LARGEST_CONDITION)


@dataclass(frozen=True)
class Direction:
    """A direction that the image observations of one EOP set do not determine, in the words of ``fg_orient.adjust``.

    Parameters
    ----------
    eop_set : int
    image : str
        "" for the whole block.
    words : str
    held_by : "nothing" or "prior"
        "nothing": a singular value up to 1e-5 of the image's Jacobian, unknowns in prior sigmas.
    """

    eop_set: int
    image: str
    words: str
    held_by: str


@dataclass(frozen=True)
class Curve:
    """L-curve of the bundle of the published procedure with one set, for the Tikhonov solvers.

    Parameters
    ----------
    eop_set, type : int
        Type of the pre-adjustment.
    curve : LCurve
        Unknowns in m, m/s and rad together, residuals as published.
    """

    eop_set: int
    type: int
    curve: LCurve

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Curve:
        """Curve of its ``dataclasses.asdict``."""
        curve = dict(values["curve"])
        choices = tuple(Choice(**{**c, "notes": tuple(c["notes"])}) for c in curve.pop("choices"))
        return cls(values["eop_set"], values["type"], LCurve(**curve, choices=choices))


@dataclass(frozen=True)
class Comparison:
    """Result of :func:`fg_orient.compare`.

    Parameters
    ----------
    block : Block
        The adjusted block.
    rows : tuple of Row
    spectra : tuple of Spectrum
    target_m : float
        RMSE to reach.
    eop_sets, solvers, backends, types : tuples
        Selections of the caller.
    as_run : bool
        The published procedure as the authors' program works.
    seconds : float
        Wall-clock time of the comparison.
    labels : dict
        Solver name to its label.
    directions : tuple of Direction
        Directions that no observation determines, set by set.
    curves : tuple of Curve
        L-curves of the published procedure, if Tikhonov solvers are selected.
    """

    block: Block
    rows: tuple[Row, ...]
    spectra: tuple[Spectrum, ...]
    target_m: float
    eop_sets: tuple[int, ...]
    solvers: tuple[str, ...]
    backends: tuple[str, ...]
    types: tuple[int, ...]
    as_run: bool
    seconds: float
    labels: dict[str, str] = field(default_factory=dict)
    directions: tuple[Direction, ...] = ()
    curves: tuple[Curve, ...] = ()

    @property
    def table(self) -> Any:
        """The rows as ``pandas.DataFrame``; without pandas (extra "tables") a list of dicts."""
        records = [row.as_dict() for row in self.rows]
        if find_spec("pandas") is None:
            return records
        import pandas

        return pandas.DataFrame.from_records(records, columns=list(COLUMNS))

    def select(self, **wanted: object) -> tuple[Row, ...]:
        """Rows whose columns have the given values."""
        return tuple(r for r in self.rows if all(getattr(r, name) == value for name, value in wanted.items()))


def groups(rows: Sequence[Row]) -> dict[tuple[str, int | None, str], list[Row]]:
    """Rows by backend, type and solver, in order of appearance."""
    out: dict[tuple[str, int | None, str], list[Row]] = {}
    for row in rows:
        out.setdefault((row.backend, row.type, row.solver), []).append(row)
    return dict(sorted(out.items(), key=lambda item: (BACKENDS.index(item[0][0]), item[0][1] or 0)))


def tried(comparison: Comparison) -> dict[tuple[str, int | None, str], list[Row | None]]:
    """Rows by EOP set of each backend, type and solver of which any adjustment was tried; None for a missing row."""
    out: dict[tuple[str, int | None, str], list[Row | None]] = {}
    for key, rows in groups(comparison.rows).items():
        if not all(row.left_out for row in rows):
            by_set = {row.eop_set: row for row in rows}
            out[key] = [by_set.get(number) for number in comparison.eop_sets]
    return out


T = TypeVar("T")


def _words(given: Any) -> list[str]:
    """Words of a selection: a number, words between commas, or a list of both."""
    if isinstance(given, int):
        return [str(given)]
    return [str(word).strip() for word in (given.split(",") if isinstance(given, str) else given)]


def _once(chosen: Iterable[T], option: str, given: object) -> tuple[T, ...]:
    """Drop repetitions; raise InputError for an empty selection."""
    out = tuple(dict.fromkeys(chosen))
    if not out:
        raise InputError.of("compare.nothing", option=option, value=given)
    return out


def _chosen(given: Any, members: Mapping[str, Sequence[T]], option: str, code: str) -> tuple[T, ...]:
    """Members of the words of a selection; each once. InputError with this code for an unknown word."""
    words = _words(given)
    for word in words:
        if word not in members:
            raise InputError.of(code, option=option, value=word, known=", ".join(members))
    return _once((member for word in words for member in members[word]), option, given)


def eop_sets(given: str | int | Iterable[int | str]) -> tuple[int, ...]:
    """Numbers of the EOP sets in "1-20", "5,13,PUA" or a list of numbers and names; each once."""
    chosen: list[int] = []
    for word in _words(given):
        first, dash, last = word.partition("-")
        numbers = range(eop_set_number(first), eop_set_number(last if dash else first) + 1)
        if not numbers:
            raise InputError.of("compare.nothing", option="eop_sets", value=word)
        chosen += numbers
    return _once(chosen, "eop_sets", given)


def solver_names(given: str | Iterable[str]) -> tuple[str, ...]:
    """Names of the solvers in "all", "published", "svd,qr" or a list of names; each once."""
    known = registry.solvers()
    groups = {"all": list(known), "published": [name for name, one in known.items() if one.published]}
    return _chosen(given, {name: [name] for name in known} | groups, "solvers", "linear.solver")


def backend_names(given: str | Iterable[str]) -> tuple[str, ...]:
    """Names of the backends in "faithful,graph" or a list, in the order of ``BACKENDS``."""
    chosen = _chosen(given, {name: [name] for name in BACKENDS}, "backends", "adjust.backend")
    return tuple(sorted(chosen, key=BACKENDS.index))


def types(given: str | int | Iterable[int | str]) -> tuple[int, ...]:
    """Types of pre-adjustment in "1,2" or a list, in order."""
    return tuple(sorted(_chosen(given, {str(kind): [kind] for kind in TYPES}, "types", "compare.type")))


def target(given: float | None) -> float | None:
    """Length to reach, m; None as given."""
    if given is not None and not (math.isfinite(given) and given > 0.0):
        raise InputError.of("compare.target", option="target", value=given)
    return given


#: Arguments of ``compare`` to functions that check them and raise InputError.
SELECTIONS: Final[dict[str, Callable[[Any], Any]]] = {
    "eop_sets": eop_sets, "solvers": solver_names, "backends": backend_names, "types": types, "target_m": target,
}  # fmt: skip
