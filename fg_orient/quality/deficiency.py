"""Detection of unknowns that the observations do not determine, before the adjustment.

Such unknowns are reported if priors or a regularisation determine them; otherwise the block is refused. The checks
have the order in which a user corrects a block. First come unknowns with too few observations (structure),
then physically unobservable directions of an image, motions of the block that no control point fixes, and
other directions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.border_matrix import triangle
from fg_orient.adjustment.constraints import prepared
from fg_orient.adjustment.problem import Problem, compile_problem
from fg_orient.adjustment.rows import AT_ONCE, held, image_rows, rows_by_image, some_rows
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.model.block import Block
from fg_orient.model.errors import FgOrientError, Finding, InputError, RankDeficientError, finding
from fg_orient.quality.mix_ups import mix_ups
from fg_orient.quality.observability import (
    BlockObservability,
    ImageObservability,
    affordable,
    analyse,
    analyse_block,
    part_sentence,
)
from fg_orient.quality.structure import Structure, analyse_structure

#: Codes of errors that describe undetermined unknowns.
DEFICIENT: Final = (
    "adjust.rank_deficient",
    "adjust.rank_without_control",
    "statistics.too_few",
    "statistics.motions",
)
#: Number of image points that is sufficient to determine the motions of a block too large for a decomposition.
ENOUGH: Final = 20_000


@dataclass(frozen=True)
class Evidence:
    """Results of the analysis of a block that was refused.

    Parameters
    ----------
    problem : Problem
        The compiled block, with start values of the unknowns.
    observability : tuple of ImageObservability
        Observability of each image; empty if the structure alone led to the refusal.
    view : BlockObservability or None
        Observability of the whole block; None if the structure or single images led to the refusal.
    """

    problem: Problem
    observability: tuple[ImageObservability, ...]
    view: BlockObservability | None


def compiled_problem(block: Block, like: Problem | None = None, *, at_once: bool = True) -> Problem:
    """Compile a block; the error for a block without control points lists the free motions of each part.

    If rays do not meet, the error names mix-ups of tables and metadata that explain this.
    ``compile_problem`` describes the parameters and the other errors. The records of the image points are
    computed now; if not ``at_once``, some rows are computed when they are needed.
    """
    try:
        compiled = prepared(compile_problem(block, like))
        return compiled if not at_once else held(compiled, "records")
    except InputError as error:
        if any(p.code.startswith("initial.") for p in error.problems):
            raise InputError(*error.problems, *(one.finding(block) for one in mix_ups(block))) from None
        if [p.code for p in error.problems] != ["block.no_control"]:
            raise
        raise InputError(*error.problems, *_motions_without_control(block)) from None


def _motions_without_control(block: Block) -> list[Finding]:
    """Return one error per part of a block without control points; none if the block has other errors."""
    loose = replace(block, options=replace(block.options, datum="free", priors=False))
    try:
        compiled = prepared(compile_problem(loose))
    except FgOrientError:
        return []
    with one_blas_thread():
        view = analyse_block(compiled) if affordable(compiled) else analyse_block(_thinned(compiled), whole=False)
    return _motion_faults(view)


def judge_observability(compiled: Problem) -> tuple[ImageObservability, ...]:
    """Analyse the unknowns of each image by the singular values of its whitened Jacobian at the start values."""
    out = []
    with one_blas_thread():
        for k, rows in enumerate(rows_by_image(compiled)):
            model, shorter = compiled.models[k], list[Array]()
            for begin in range(0, max(len(rows), 1), AT_ONCE):
                part = rows[begin : begin + AT_ONCE]
                jacobian = image_rows(compiled, compiled.start, k, part, jacobian=True)[1]
                shorter.append(triangle(jacobian.reshape(2 * len(part), len(model.parameters))))
            out.append(analyse(compiled.block.images[k].id, np.vstack(shorter), model))
    return tuple(out)


def refuse_deficient(compiled: Problem, observability: tuple[ImageObservability, ...]) -> BlockObservability:
    """Analyse the whole block, and refuse it if some unknowns are undetermined.

    Raises
    ------
    RankDeficientError
        The error lists one problem per unknown with too few observations, per unobservable direction of an image, or
        per part of the block that no control point fixes.
    """
    structure = analyse_structure(compiled)
    _refuse(compiled, observability, _structural(compiled, structure, observability))
    with one_blas_thread():
        view = _view(compiled, structure)
    if not compiled.block.options.holds_unknowns:
        _refuse(compiled, observability, _numerical(compiled, view), view)
    return view


def require_determined(compiled: Problem) -> None:
    """Refuse the same blocks as :func:`refuse_deficient`; with priors only the structure is analysed."""
    if compiled.block.options.holds_unknowns:
        _refuse(compiled, (), _structural(compiled, analyse_structure(compiled), ()))
    else:
        refuse_deficient(compiled, judge_observability(compiled))


def _view(compiled: Problem, structure: Structure) -> BlockObservability:
    """Analyse the whole block if its size allows it or it has no priors, otherwise only its motions."""
    if not compiled.block.options.holds_unknowns or affordable(compiled):
        return analyse_block(compiled, structure)
    return analyse_block(_thinned(compiled), structure, whole=False)


def _thinned(compiled: Problem) -> Problem:
    """Return the block with all control points and a part of the other ground points."""
    o = compiled.observations
    step = -(-len(o) // ENOUGH)
    control = compiled.observed | ~compiled.active
    rows = np.flatnonzero(control[o.point] | (o.point % step == 0))
    return replace(compiled, observations=o.take(rows), records=some_rows(compiled, "records", rows))


def _structural(
    compiled: Problem, structure: Structure, observability: tuple[ImageObservability, ...]
) -> list[Finding]:
    """List the errors of structure and of single images.

    If steps are damped, undetermined points and images are no errors.
    """
    floating = compiled.least_damping > 0.0 and compiled.redundancy >= 0
    lacks = () if floating else structure.lacks
    out = [finding("statistics.too_few", place=lack.sentence, remedy=lack.remedy) for lack in lacks]
    if compiled.block.options.holds_unknowns:
        return out
    seen = [o for o in observability if lacks == () or o.rank_defect < len(o.singular_values)]
    sentences = [sentence for o in seen for sentence in o.sentences]
    return out + [finding(_code(compiled), place=sentence) for sentence in sentences]


def _code(compiled: Problem) -> str:
    """Return the code of an undetermined direction: the remedy depends on control points."""
    return "adjust.rank_deficient" if compiled.has_control else "adjust.rank_without_control"


def _numerical(compiled: Problem, view: BlockObservability) -> list[Finding]:
    """List the errors of the whole block. Free motions are not an error if the datum is free."""
    loose = compiled.block.options.datum in ("free", "inner")
    dead = sum(int(m.unobservable.sum()) for m in view.motions)
    out = [] if loose or not dead else _motion_faults(view)
    if compiled.block.options.datum == "inner":
        near = [m for m in view.motions if not m.unobservable.all()]
        out += [finding("statistics.datum_near", place=part_sentence(m, priors=False), value=len(m)) for m in near]
    others = view.sentences[len(view.sentences) - view.unexplained :]
    return out + [finding(_code(compiled), place=sentence) for sentence in others]


def _motion_faults(view: BlockObservability) -> list[Finding]:
    return [
        finding("statistics.motions", place=part_sentence(m, priors=False), value=len(m), remedy=m.remedy)
        for m in view.motions
    ]


def _refuse(
    compiled: Problem,
    observability: tuple[ImageObservability, ...],
    faults: Sequence[Finding],
    view: BlockObservability | None = None,
) -> None:
    if not faults:
        return
    counts = {
        "n_observations": compiled.n_observations,
        "n_unknowns": compiled.n_unknowns,
        "redundancy": compiled.n_observations - compiled.n_unknowns,
    }
    defect = {o.image: o.rank_defect for o in observability}
    raise RankDeficientError(
        *faults, rank_defect=defect, counts=counts, evidence=Evidence(compiled, observability, view)
    )
