"""From a problem to an estimate: choose backend and optimiser, run, linearise at the end."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from factors._contract import NotFiniteError
from fg_orient.adjustment.loop import OPTIMIZERS, ROUNDING_STEP, Callback, IterationRecord
from fg_orient.adjustment.problem import Problem, State
from fg_orient.block import Options
from fg_orient.errors import InputError, NoSolutionError
from fg_orient.linear.threads import one_blas_thread

if TYPE_CHECKING:
    from fg_orient.adjustment.dense import DenseSystem
    from fg_orient.adjustment.graph import GraphSystem
    from fg_orient.adjustment.schur import SchurSystem

#: Names of ``--optimizer``; the native ones are GTSAM's own, for equality tests on small blocks.
NATIVE = ("native", "native-levenberg-marquardt", "native-dogleg")
OPTIMIZER_NAMES = (*OPTIMIZERS, *NATIVE)
#: "auto" is the Schur complement for blocks it was made for (:func:`chosen_backend`), else the graph; dense
#: matrices are for comparison and are asked for by name.
BACKENDS = ("auto", "graph", "schur", "dense")
#: Image points from which "auto" takes the Schur complement.
SCHUR_FROM = 100


@dataclass(frozen=True)
class Estimate:
    """End of the optimisation.

    Parameters
    ----------
    state : State
    chi2 : float
        Weighted sum of squares.
    backend : str
        "graph", "schur" or "dense".
    solver : str
        Linear solver of the dense backend; "" for the others.
    linear : GraphSystem, SchurSystem or DenseSystem
        The undamped linearisation at the state, for cofactors.
    structure_s, solve_s : float
        Wall-clock seconds: building the graph, optimising.
    """

    state: State
    chi2: float
    converged: bool
    reason: str
    log: tuple[IterationRecord, ...]
    iterations: int
    backend: str
    solver: str
    linear: GraphSystem | SchurSystem | DenseSystem
    structure_s: float
    solve_s: float


def solve(
    problem: Problem, callback: Callback | None = None, schur: Callable[[Problem], Any] | None = None
) -> Estimate:
    """Adjust through the backend of the block's options.

    ``schur`` makes another backend that does what the Schur backend does, and is then taken whatever the options say
    (``fg_orient.parallel``).

    Raises
    ------
    InputError
        Unknown backend, optimiser or solver; a native optimiser on too large a block; a dense
        adjustment of too many unknowns; a block that the Schur backend cannot take.
    NoSolutionError
        The equations become singular or not finite on the way.
    """
    _judge(problem.block.options)
    try:
        with _garbage_collection_off():
            return _run(problem, callback) if schur is None else _run_schur(problem, callback, schur)
    except (NotFiniteError, RuntimeError) as error:
        raise NoSolutionError.of("adjust.broken_down", place=problem.block.name, why=first_sentence(error)) from error


def chosen_backend(problem: Problem) -> str:
    """Backend of the options; for "auto" the Schur complement if it can take the block and pays, else the graph.

    Without priors the graph is taken: its QR does not square the condition.
    """
    options = problem.block.options
    if options.backend != "auto":
        return options.backend
    from fg_orient.adjustment.schur_structure import reason_against

    large = len(problem.observations) >= SCHUR_FROM and bool(problem.active.any())
    possible = options.priors and options.optimizer in OPTIMIZERS and not reason_against(problem)
    return "schur" if large and possible else "graph"


def _judge(options: Options) -> None:
    """Refuse names that do not exist and choices that do not go together."""
    if options.backend not in BACKENDS:
        raise InputError.of("adjust.backend", place="backend", value=options.backend, known=", ".join(BACKENDS))
    own = options.backend in ("dense", "schur")
    names = tuple(OPTIMIZERS) if own else OPTIMIZER_NAMES
    if options.optimizer in NATIVE and own:
        raise InputError.of("adjust.native_dense", place="optimizer", value=options.optimizer, known=", ".join(names))
    if options.optimizer not in names:
        raise InputError.of("adjust.optimizer", place="optimizer", value=options.optimizer, known=", ".join(names))
    if options.solver is not None and options.backend != "dense":
        raise InputError.of("adjust.solver_dense", place="solver", value=options.solver, backend=options.backend)


def first_sentence(error: Exception) -> str:
    """One line of an exception's text: GTSAM's own run over many."""
    return " ".join(str(error).split())[:160]


@contextmanager
def _garbage_collection_off() -> Iterator[None]:
    """Thousands of factors make no garbage, but searching them costs 7 us each at every turn (measured)."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _run(problem: Problem, callback: Callback | None) -> Estimate:
    """Run the backend; what "auto" gave to the Schur complement in vain gets the graph and its QR."""
    backend = chosen_backend(problem)
    try:
        return {"dense": _run_dense, "schur": _run_schur, "graph": _run_graph}[backend](problem, callback)
    except RuntimeError:
        if (problem.block.options.backend, backend) != ("auto", "schur"):
            raise
    return _run_graph(problem, callback)


def _run_graph(problem: Problem, callback: Callback | None) -> Estimate:
    """Build the graph, optimise, linearise at the end."""
    options = problem.block.options
    from fg_orient.adjustment.graph import GraphBackend, run_native

    marks = [time.perf_counter()]
    backend = GraphBackend(problem)
    marks.append(time.perf_counter())
    log: tuple[IterationRecord, ...] = ()
    if options.optimizer in NATIVE:
        values, iterations, error = run_native(backend, options.optimizer, options.max_iterations)
        # GTSAM does not say whether it converged: one more undamped step tells
        remaining = backend.linearise(values).solve(0.0).length
        converged, reason = (
            remaining < ROUNDING_STEP,
            f"GTSAM's own optimiser ended with a step of {remaining:.1e} left",
        )
    else:
        result = OPTIMIZERS[options.optimizer](backend, backend.initial(), options.max_iterations, callback)
        values, iterations, error = result.state, len(result.log), result.error
        converged, reason, log = result.converged, result.reason, result.log
    marks.append(time.perf_counter())
    return Estimate(
        backend.state(values), 2.0 * error, converged, reason, log, iterations, backend.name, "",
        backend.linearise(values), marks[1] - marks[0], marks[2] - marks[1],
    )  # fmt: skip


def _run_dense(problem: Problem, callback: Callback | None) -> Estimate:
    """Optimise on full matrices, linearise at the end."""
    options = problem.block.options
    from fg_orient.adjustment.dense import DEFAULT_SOLVER, DenseBackend

    marks = [time.perf_counter()]
    backend = DenseBackend(problem, options.solver or DEFAULT_SOLVER)
    marks.append(time.perf_counter())
    result = OPTIMIZERS[options.optimizer](backend, backend.initial(), options.max_iterations, callback)
    marks.append(time.perf_counter())
    return Estimate(
        result.state, 2.0 * result.error, result.converged, result.reason, result.log, len(result.log), backend.name,
        backend.solver, backend.linearise(result.state), marks[1] - marks[0], marks[2] - marks[1],
    )  # fmt: skip


def _run_schur(problem: Problem, callback: Callback | None, make: Callable[[Problem], Any] | None = None) -> Estimate:
    """Compile to arrays, optimise, linearise at the end."""
    options = problem.block.options
    from fg_orient.adjustment.schur import SchurBackend

    marks = [time.perf_counter()]
    backend = (make or SchurBackend)(problem)
    marks.append(time.perf_counter())
    with one_blas_thread():
        result = OPTIMIZERS[options.optimizer](backend, backend.initial(), options.max_iterations, callback)
        marks.append(time.perf_counter())
        linear = backend.linearise(result.state)
    return Estimate(
        result.state, 2.0 * result.error, result.converged, result.reason, result.log, len(result.log), backend.name,
        "", linear, marks[1] - marks[0], marks[2] - marks[1],
    )  # fmt: skip
