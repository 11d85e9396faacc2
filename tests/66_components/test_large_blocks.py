"""The level of tests with variance components is correct on a block with 1700 rows."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

import fg_orient as fg
from fg_orient.quality import hypotheses
from fg_orient.quality import observation_groups as module
from fg_orient.quality.observation_groups import GroupedResiduals, groups_of
from fg_orient.quality.suspects import suspects
from fg_orient.quality.variance_components import freedoms, variance_components
from tests.support.full_statistics import turned_design
from tests.support.planted_errors import planted_large

pytestmark = pytest.mark.oracle

GROUPS = ("image", "position", "height")
LEVEL = 0.05


def interval(runs: int, level: float = LEVEL) -> tuple[int, int]:
    """Return the 99.9 % interval of the number of alarms in ``runs`` independent tests."""
    low, high = binom.ppf([5e-4, 1.0 - 5e-4], runs, level)
    return int(low), int(high)


def alarms(runs: int, seed: int, monkeypatch: pytest.MonkeyPatch) -> dict[str, tuple[int, int]]:
    """Return the numbers of alarms of one preselected observation of each part.

    The first uses its own freedom, the second that of its group. The model is linear at a solution, with errors of the
    stated sigmas; one round of Helmert's equations gives the components, and the variance of each error is the mixture
    of them.
    """
    block = planted_large().draw(np.random.default_rng(seed))
    solution = fg.adjust(block)
    problem, known = solution.problem, solution.residual_cofactors
    assert problem.n_observations > 1500
    residuals = GroupedResiduals(known, groups_of(problem, GROUPS))
    components = variance_components(known, groups=GROUPS)
    assert components.exact and not any(c.held for c in components.components) and residuals.parts is not None
    basis = np.linalg.qr(turned_design(problem, solution.state)).Q
    draws = np.random.default_rng(seed + 1).standard_normal((runs, len(basis)))
    v = draws - (draws @ basis) @ basis.T
    q = np.stack([np.sum(v[:, residuals.labels == g] ** 2, axis=1) for g in range(len(GROUPS))], axis=1)
    variances = np.linalg.solve(residuals.parts.shared[:-1, :-1], q.T).T
    monkeypatch.setattr(module, "LARGEST", 0)
    as_too_large = GroupedResiduals(known, residuals.groups)
    out = {}
    for s in suspects(known, "coordinates"):
        rows, columns, k = s.rows, s.columns, 3
        share = residuals.parts.shares(s.point[[k]], rows[[k]], columns[[k]])[0, :-1]
        nu = freedoms(residuals, [s], components)[k]
        own = freedoms(as_too_large, [s], components)[k]
        error = np.zeros(len(basis))
        error[rows[k]] = columns[k, :, 0]
        effect = error - basis @ (basis.T @ error)
        scale = np.maximum(variances @ share, 1e-9)
        t = (v @ error) ** 2 / (error @ effect) / scale
        out[s.part] = tuple(_count(t, freedom) for freedom in (nu, own))
    return out


def _count(t: np.ndarray, freedom: float) -> int:
    """Return the number of alarms at the level, from T and f of ``fg_orient.quality.outliers``."""
    f = np.full(len(t), freedom)
    return int(np.sum(hypotheses.probabilities(np.minimum(t, f), np.ones(len(t), int), f, f, "t") < LEVEL))


def test_sizes_of_the_linear_twin(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tests with variance components have their level in 600 runs; with the freedom of all heights they have not."""
    found = alarms(600, 31, monkeypatch)
    low, high = interval(600)
    assert {part: low <= mine <= high for part, (mine, _) in found.items()} == dict.fromkeys(found, True), found
    assert found["up"][1] > high, found


@pytest.mark.slow
def test_sizes_of_whole_adjustments() -> None:
    """In 300 whole adjustments with components tests of each kind, and any alarm, have the level of 5 %.

    The tested observations are chosen beforehand.
    """
    runs, planted = 300, planted_large()
    found = {"image": 0, "position": 0, "height": 0, "any": 0}
    for seed in range(7000, 7000 + runs):
        solution = fg.adjust(planted.draw(np.random.default_rng(seed)), variance_components=GROUPS)
        assert solution.components is not None and solution.components.exact
        tests = solution.outlier_tests(level=LEVEL, control="none")
        order = np.lexsort((tests.row, tests.point, tests.part))  # the same observation in every run
        for part in ("image", "position", "height"):
            mine = order[tests.part[order] == tests.parts.index(part)]
            found[part] += int(tests.probability[mine[3]] < LEVEL)
        found["any"] += bool(solution.outlier_tests(level=LEVEL, control="sidak").n_suspicious)
    print(f"\n{found} of {runs}")
    low, high = interval(runs)
    assert all(low <= found[part] <= high for part in ("image", "position", "height")), found
    assert low <= found["any"] <= high, found
