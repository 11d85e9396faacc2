"""Data of a comparison: rows, EOP sets, singular values, directions and L-curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Final, NamedTuple, get_args

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.linear.l_curve import Choice, LCurve
from fg_orient.model.block import Block
from fg_orient.model.names import TIME_LIMIT_S
from fg_orient.model.options import Optimizer

if TYPE_CHECKING:
    from fg_orient.studies.comparison.advice import Advice
    from fg_orient.studies.comparison.set_results import SetResult

#: Names of the engines: the published procedure; :func:`fg_orient.adjust` with full
#: matrices, with arrays and eliminated points, with the graph that has a factor for each
#: image point, and with the graph of eliminated points.
BACKENDS: Final = ("faithful", "dense", "schur", "explicit", "graph")
TYPES: Final = (1, 2)
#: Names of the optimisers of the graphs and of our loop over arrays.
OPTIMIZERS: Final = get_args(Optimizer)
OPTIMIZER_WORDS: Final = {
    "gauss-newton": "Gauss-Newton", "levenberg-marquardt": "Levenberg-Marquardt", "dogleg": "Dogleg",
}  # fmt: skip
#: Methods for the reduced system of the Schur backend, with their labels.
REDUCED_LABELS: Final = {
    "dense": "full Cholesky, LAPACK", "banded": "band Cholesky, LAPACK", "graph": "sparse Cholesky, GTSAM",
    "iterative": "conjugate gradients", "implicit": "conjugate gradients, no matrix",
}  # fmt: skip
#: Names of the solvers of the graphs in the tables: GTSAM's optimisers, and our loop with GTSAM's elimination.
GRAPH_SOLVER: Final = "gtsam"
LOOP_SOLVER: Final = "gtsam_loop"
GRAPH_LABELS: Final = {GRAPH_SOLVER: "GTSAM", LOOP_SOLVER: "GTSAM elimination, our loop"}
AXES: Final = ("x", "y", "z")
#: Value in the column ``regularisation`` if there is no regularisation.
UNREGULARISED: Final = "none"
#: Note of the row with the method that the program itself would choose for the Schur backend.
OWN_CHOICE: Final = "the program's own choice"
#: A singular value below eps times the largest one is rounding. This condition number of N means "at least this".
LARGEST_CONDITION: Final = float(np.finfo(float).eps ** -2)
_NAN: Final = float("nan")


@dataclass(frozen=True)
class Row:
    """Row of a comparison, which describes one adjustment; missing numbers are nan or None.

    Parameters
    ----------
    eop_set, eop_set_name : int, str
    solver : str
        Name in the registry of ``fg_orient.adjustment.linear``; method for the reduced
        system ("schur"); "gtsam" or "gtsam_loop" for the graphs.
    backend : str
        One of :data:`BACKENDS`.
    type : int or None
        Pre-adjustment of the published procedure: 1 look angles, 2 look angles and EOPs.
    optimizer : str
        "" for the published procedure.
    regularisation : str
        Regularisation of the image unknowns: "none", or the method with its rule or kappa
        ("tikhonov:gcv", "truncated:0.1"), or with the cut of its rank
        ("minimum_norm:1e-09"). It is "" for the published procedure, whose solvers
        regularise.
    control_rmse_m, check_rmse_m : float
        RMSE of the worst of the three ECEF axes, as published (Terlemezoğlu 2019, eq.
        2.72); nan without points.
    control_rmse_x_m ... check_rmse_z_m : float
        RMSE of each axis.
    cond_raw, cond_scaled : float
        Condition numbers of ``N = A^T A``, computed as the square of the condition number
        of A: with unknowns in m, m/s, rad; with columns of A of unit length. At most
        :data:`LARGEST_CONDITION`.
    rank, order : int or None
        Numerical rank of A in raw units, and the number of unknowns.
    kappa : float
        Parameter of the regularisation, or of a Tikhonov solver of the published procedure.
    sigma0 : float
        A posteriori standard deviation of unit weight, without the rows of a penalty; nan
        for the published procedure.
    m0_rad : float
        ``sqrt(v^T v / redundancy)`` of the look angles, for the published procedure.
    iterations : int
    processor_s : float
        Processor time of this adjustment over all threads, without statistics, s.
    peak_bytes : float
        Increase of the resident memory during the adjustment; nan if the system does not report it.
    operations, factor_elements, fill : float
        Predicted numbers (``work``): operations of the linear algebra in one iteration;
        elements of the factor; elements of the factor that are zero in the normal matrix.
    forward_error : float
        Relative error of the first step, compared with a solution with 256 bits
        (``reference``). It refers to the image unknowns in prior sigmas; for the
        published procedure, to all unknowns times the lengths of their columns. nan for
        large or singular systems, and for damped steps.
    cond_reduced : float
        Condition number of the reduced normal matrix at the solution, with image unknowns in prior sigmas.
    reached : bool
        Whether both RMSE are at most the target; without check points, only the RMSE of control points counts.
    difference_sigmas, difference_m : float
        Largest differences from :func:`fg_orient.adjust` with the options of the block
        and the same regularisation: of an orientation unknown, in prior sigmas, and of a
        ground coordinate, m. nan if one of the two solutions is missing.
    failure : str
        Reason for a missing solution; "" if there is one.
    left_out : bool
        True if the adjustment was not tried; ``failure`` is then the reason.
    notes : tuple of str
        Remarks of the solver.
    """

    eop_set: int
    eop_set_name: str
    solver: str
    backend: str
    type: int | None = None
    optimizer: str = ""
    regularisation: str = ""
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
    processor_s: float = _NAN
    peak_bytes: float = _NAN
    operations: float = _NAN
    factor_elements: float = _NAN
    fill: float = _NAN
    forward_error: float = _NAN
    cond_reduced: float = _NAN
    reached: bool = False
    difference_sigmas: float = _NAN
    difference_m: float = _NAN
    failure: str = ""
    left_out: bool = False
    notes: tuple[str, ...] = ()

    @property
    def key(self) -> Key:
        """Return the engine of the row."""
        return Key(self.backend, self.type, self.solver, self.optimizer, self.regularisation)

    def as_dict(self) -> dict[str, Any]:
        """Return the columns by name."""
        return asdict(self) | {"notes": "; ".join(self.notes)}


COLUMNS: Final = tuple(f.name for f in fields(Row))


@dataclass(frozen=True)
class Spectrum:
    """Singular values of one design matrix A, in descending order.

    Parameters
    ----------
    eop_set : int
    system : str
        "published 1", "published 2" (bundle after the pre-adjustment of type 1, 2),
        "adjustment" (of :func:`fg_orient.adjust`, priors included), "adjustment,
        tikhonov:gcv" (with the penalty of a regularisation) or "no priors" (without
        priors and penalty).
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
        """Condition number of ``N = A^T A``, the square of the condition number of A.

        At most :data:`LARGEST_CONDITION`.
        """
        smallest = max(float(self.values[-1]), float(self.values[0]) * np.finfo(float).eps)
        return min(float((self.values[0] / smallest) ** 2), LARGEST_CONDITION)


@dataclass(frozen=True)
class Direction:
    """Direction that the image observations of one EOP set do not determine, as ``fg_orient.adjust`` describes it.

    Parameters
    ----------
    eop_set : int
    image : str
        Id of the image; "" for the whole block.
    words : str
    held_by : "nothing" or "prior"
        What determines the direction. "nothing" means that the image's Jacobian has a
        singular value of at most 1e-5, with unknowns in prior sigmas.
    """

    eop_set: int
    image: str
    words: str
    held_by: str


@dataclass(frozen=True)
class Curve:
    """L-curve of the published bundle with one set, for the Tikhonov solvers.

    Parameters
    ----------
    eop_set, type : int
        Type of the pre-adjustment.
    curve : LCurve
        L-curve. The norm combines unknowns in m, m/s and rad; residuals are as published.
    """

    eop_set: int
    type: int
    curve: LCurve

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Curve:
        """Make a curve from its ``dataclasses.asdict``."""
        curve = dict(values["curve"])
        choices = tuple(Choice(**{**c, "notes": tuple(c["notes"])}) for c in curve.pop("choices"))
        return cls(values["eop_set"], values["type"], LCurve(**curve, choices=choices))


@dataclass(frozen=True)
class ErrorVectors:
    """Errors of points after the published procedure with one set, pre-adjustment and solver.

    Parameters
    ----------
    eop_set, type, solver : int, int, str
        Row to which the errors belong.
    ids : dict
        Ids of the points by role ("control", "check").
    enu_m : dict
        Errors (n, 3) by role, computed minus measured, East, North, Up at the middle of the control points.
    """

    eop_set: int
    type: int
    solver: str
    ids: dict[str, tuple[str, ...]]
    enu_m: dict[str, Array]

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> ErrorVectors:
        """Make error vectors from their ``dataclasses.asdict``."""
        ids = {role: tuple(own) for role, own in values["ids"].items()}
        return cls(**values | {
            "ids": ids, "enu_m": {r: np.reshape(v, (-1, 3)) for r, v in values["enu_m"].items()},
        })  # fmt: skip


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
    eop_sets, solvers, backends, types, regularisations : tuples
        Selections that the caller has made.
    as_run : bool
        Whether the published procedure was run as the authors' program does.
    seconds : float
        Wall-clock time of the comparison.
    labels : dict
        Solver name to its label.
    repeated : dict
        Sets with the same unknowns as another set, and that other set. They are not compared.
    time_limit_s : float
        Adjustments with a longer predicted processor time, s, are not tried.
    target_from : str
        "given", "predicted" (limit of the RMSE at the check points) or "pixel".
    sets : tuple of SetResult
        Adjustments with each set and regularisation by :func:`fg_orient.adjust`.
    advice : Advice or None
        Recommended set, regularisation and engine.
    directions : tuple of Direction
        Directions that no observation determines, for each set.
    curves : tuple of Curve
        L-curves of the published procedure, if Tikhonov solvers are selected.
    vectors : tuple of ErrorVectors
        Error vectors of each row of the published procedure that has a solution.
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
    repeated: dict[int, int] = field(default_factory=dict)
    time_limit_s: float = TIME_LIMIT_S
    target_from: str = "given"
    sets: tuple[SetResult, ...] = ()
    advice: Advice | None = None
    directions: tuple[Direction, ...] = ()
    curves: tuple[Curve, ...] = ()
    regularisations: tuple[str, ...] = (UNREGULARISED,)
    vectors: tuple[ErrorVectors, ...] = ()

    @property
    def table(self) -> Any:
        """Return the rows as ``pandas.DataFrame``; without pandas (extra "tables"), as a list of dicts."""
        records = [row.as_dict() for row in self.rows]
        if find_spec("pandas") is None:
            return records
        import pandas

        return pandas.DataFrame.from_records(records, columns=list(COLUMNS))

    def select(self, **wanted: object) -> tuple[Row, ...]:
        """Return the rows whose columns have the given values."""
        return tuple(r for r in self.rows if all(getattr(r, name) == value for name, value in wanted.items()))


class Key(NamedTuple):
    """Engine of a row: the columns that identify it."""

    backend: str
    type: int | None
    solver: str
    optimizer: str
    regularisation: str = ""

    def name(self, labels: Mapping[str, str]) -> str:
        """Return the name of the engine in words; ``labels`` contains the labels of solvers by name."""
        words = regularisation_words(self.regularisation)
        return self._of_engine(labels) + (f", {words}" if words else "")

    def _of_engine(self, labels: Mapping[str, str]) -> str:
        label = labels.get(self.solver, self.solver)
        optimizer = OPTIMIZER_WORDS.get(self.optimizer, self.optimizer)
        match self.backend:
            case "schur":
                own = REDUCED_LABELS.get(self.solver, label)
                return f"arrays · {own}" if self.optimizer == OPTIMIZERS[0] else f"arrays · {own}, {optimizer}"
            case "explicit":
                return f"explicit graph · {label}, {optimizer}"
            case "graph":
                return f"graph · {label}, {optimizer}"
            case "faithful":
                return f"published {self.type} · {label}"
        return f"{self.backend} · {label}"


def regularisation_words(word: str) -> str:
    """Return the words for a regularisation, for example "tikhonov (gcv)"; "" if there is none."""
    method, _, value = word.partition(":")
    if method in ("", UNREGULARISED):
        return ""
    return method.replace("_", " ") + (f" ({value})" if value else "")


def groups(rows: Sequence[Row]) -> dict[Key, list[Row]]:
    """Group the rows by engine, in the order of their first row."""
    out: dict[Key, list[Row]] = {}
    for row in rows:
        out.setdefault(row.key, []).append(row)
    return dict(sorted(out.items(), key=lambda item: (BACKENDS.index(item[0].backend), item[0].type or 0)))


def tried(comparison: Comparison) -> dict[Key, list[Row | None]]:
    """Return, for each engine that was tried, its rows by EOP set; None for a missing row."""
    out: dict[Key, list[Row | None]] = {}
    for key, rows in groups(comparison.rows).items():
        if not all(row.left_out for row in rows):
            by_set = {row.eop_set: row for row in rows}
            out[key] = [by_set.get(number) for number in comparison.eop_sets]
    return out
