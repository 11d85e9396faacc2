"""Other minima of the same observations: which ones they do not tell from the answer."""

from __future__ import annotations

from typing import Final

from fg_orient.model.distributions import chi_square_limit, f_quantile

#: Level of the test that tells two minima apart.
LEVEL: Final = 0.05
#: Two minima whose directions differ by less (rad), and centres by less of the object's distance, are one.
SAME: Final = 1e-5


def ratio_limit(redundancy: int) -> float:
    """Ratio of weighted squares from which an F test of equal redundancies tells two minima apart at ``LEVEL``."""
    return float(f_quantile(redundancy, redundancy, 1.0 - LEVEL))


def told_apart(own: float, redundancy: int, *, known: bool = False) -> float:
    """Ratio of weighted squares from which another minimum is told from the answer.

    Parameters
    ----------
    own : float
        Weighted squares of the answer.
    redundancy : int
    known : bool
        Whether sigmas have a known size: the difference of the squares then has to exceed chi-square of one (a ratio
        of likelihoods) as well, since two minima that both fit far better than the sigmas say are both possible.
    """
    limit = ratio_limit(redundancy)
    return max(limit, 1.0 + float(chi_square_limit(1.0, LEVEL)) / own) if known and own > 0.0 else limit


def likeness(own: float, other: float, redundancy: int, *, known: bool = False) -> float | None:
    """Weighted squares of another minimum by those of the answer (see :func:`told_apart`); None if told apart."""
    if other > told_apart(own, redundancy, known=known) * own:
        return None
    return other / own if own > 0.0 else 1.0
