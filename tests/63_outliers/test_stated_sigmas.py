"""Stated sigmas of groups are compared with estimated ones: level of the test, doubt, note, gross errors."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

import fg_orient as fg
from fg_orient.model.block import Block
from fg_orient.model.names import Role, Status
from fg_orient.quality.doubts import MATTERS
from fg_orient.quality.stated_sigmas import WORDS, stated_sigmas
from fg_orient.result.summary import summary
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block
from tests.support.full_statistics import turned_design

#: Errors of the control points, m: as large as those of the image points on the ground.
ERROR_M = 20.0


def with_loose_control(seed: int, stated_m: tuple[float, float]) -> Block:
    """Return the twin with errors of 20 m in the coordinates and these stated sigmas (horizontal, vertical)."""
    block = zonguldak_block(ZonguldakOptions(seed=seed))[0]
    known, rng = block.points.known, np.random.default_rng(seed)
    sigma = known.sigma_enu_m.copy()
    control = np.isfinite(sigma).all(axis=1)
    sigma[control] = [stated_m[0], stated_m[0], stated_m[1]]
    ecef = known.ecef_m + np.where(control[:, None], rng.normal(scale=ERROR_M, size=known.ecef_m.shape), 0.0)
    points = replace(block.points, known=replace(known, ecef_m=ecef, sigma_enu_m=sigma))
    return replace(block, points=points)


def codes(solution: fg.Solution) -> dict[str, str]:
    """Return the code and place of the findings on sigmas."""
    return {f.code: f.place for f in solution.findings if f.code.startswith("verdict.sigmas")}


@pytest.mark.oracle
def test_probability_is_that_of_drawn_residuals() -> None:
    """Redundancy and probabilities of each group of sigmas equal those of 20 000 drawn residuals within 2 %.

    The residuals have the cofactors of a QR of all rows.
    """
    solution = fg.adjust(with_loose_control(1, (ERROR_M, ERROR_M)))
    q = np.linalg.qr(turned_design(solution.problem, solution.state))[0]
    n, free = len(q), solution.problem.observed
    labels = np.full(n, -1)
    rays, control = 2 * len(solution.problem.observations), 3 * int(free.sum())
    labels[:rays] = 0
    labels[rays : rays + control] = np.tile([1, 1, 2], int(free.sum()))
    white = np.random.default_rng(2).normal(size=(20_000, n))
    v = white - (white @ q) @ q.T
    words = [words for words, _ in WORDS.values()]
    found = {s.group: s for s in solution.sigmas}
    assert set(found) == set(words)
    for g, name in enumerate(words):
        drawn, one = np.einsum("dn,dn->d", v[:, labels == g], v[:, labels == g]), found[name]
        assert one.redundancy == pytest.approx(drawn.mean(), rel=0.02)
        known = solution.residual_cofactors
        own = (known.v_image, known.v_control[:, :2], known.v_control[:, 2])[g]
        assert one.larger == pytest.approx((drawn >= np.sum(own**2)).mean(), abs=0.02)
        assert one.smaller == pytest.approx(1.0 - one.larger)


@pytest.mark.slow
@pytest.mark.truth
def test_clean_blocks_have_calibrated_probabilities() -> None:
    """In 60 blocks with right sigmas probabilities below 5 % are as rare as they should be, and the factor is 1."""
    seen: dict[str, list[tuple[float, float, float]]] = {}
    for seed in range(60):
        solution = fg.adjust(with_loose_control(100 + seed, (ERROR_M, ERROR_M)))
        assert not codes(solution)
        for s in solution.sigmas:
            seen.setdefault(s.group, []).append((s.larger, s.smaller, (s.factor - 1.0) / s.sd))
    assert len(seen) == 3
    for rows in seen.values():
        larger, smaller, normal = np.array(rows).T
        for p in (larger, smaller):
            assert np.sum(p < 0.05) <= binom.ppf(0.999, len(p), 0.05)
        assert abs(normal.mean()) < 3.3 / np.sqrt(len(normal)) + 0.2  # a root is biased by a quarter of its variance
        assert 0.7 < normal.std() < 1.4


@pytest.mark.truth
def test_too_small_sigmas_are_a_doubt_with_their_factor() -> None:
    for seed in range(8):
        solution = fg.adjust(with_loose_control(seed, (ERROR_M / 4.0, ERROR_M)))
        one = {s.group: s for s in solution.sigmas}["control points horizontally"]
        assert codes(solution)["verdict.sigmas"] == "control points horizontally"
        assert solution.status is Status.NOT_TRUSTWORTHY
        assert abs(one.factor - 4.0) < 3.3 * one.sd and one.larger < 1e-6
        assert one.stated == ERROR_M / 4.0 and one.unit == "m"


@pytest.mark.behaviour
def test_adopted_sigmas_end_the_doubt() -> None:
    """The remedy of a doubt about sigmas is ``variance_components``, with which the block converges without doubt."""
    block = with_loose_control(3, (ERROR_M / 4.0, ERROR_M))
    doubt = next(f for f in fg.adjust(block).findings if f.code == "verdict.sigmas")
    assert "variance_components" in str(doubt.remedy)
    adopted = fg.adjust(block, variance_components=("image", "position", "height"))
    assert adopted.status is Status.CONVERGED and not codes(adopted)


@pytest.mark.behaviour
def test_too_large_sigmas_are_a_note() -> None:
    solution = fg.adjust(with_loose_control(2, (4.0 * ERROR_M, ERROR_M)))
    assert codes(solution) == {"verdict.sigmas_large": "control points horizontally"}
    assert solution.status is Status.CONVERGED


@pytest.mark.behaviour
def test_a_gross_error_is_not_taken_for_wrong_sigmas() -> None:
    block = with_loose_control(5, (ERROR_M, ERROR_M))
    known, j = block.points.known, int(block.points.where(Role.CONTROL)[4])
    ecef = known.ecef_m.copy()
    ecef[j] += [12.0 * ERROR_M, 0.0, 0.0]
    solution = fg.adjust(replace(block, points=replace(block.points, known=replace(known, ecef_m=ecef))))
    assert any(f.code == "verdict.gross_error" for f in solution.findings)
    assert "verdict.sigmas" not in codes(solution)
    plain = {s.group: s.larger for s in stated_sigmas(solution.residual_cofactors)}
    assert min(plain.values()) < 1e-4  # without the exception there would be a doubt
    assert MATTERS > 1.0


@pytest.mark.behaviour
def test_record_has_stated_and_estimated_sigmas() -> None:
    solution = fg.adjust(with_loose_control(4, (ERROR_M / 4.0, ERROR_M)))
    record = json.loads(json.dumps(summary(solution)["stated_sigmas"]))
    one = {s["group"]: s for s in record}["control points horizontally"]
    assert one["estimated"] == pytest.approx(one["stated"] * one["factor"])
    assert one["sentence"].startswith("stated 5 m, estimated ")
