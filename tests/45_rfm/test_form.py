"""The tests check the form of a rational function: names, counts, expansion, derivatives, coefficient order."""

from __future__ import annotations

import numpy as np
import pytest

from factors.cameras import rfm
from fg_orient.rpc.form import RfmForm
from tests.support.rpc_model import TERMS


def terms_at(ground: np.ndarray) -> np.ndarray:
    """Return the published terms of n points, (20, n)."""
    axes = dict(zip("LPH", ground.T, strict=True))
    one = [np.ones(len(ground))]
    return np.array([np.prod([axes[f] for f in term if f != "1"] + one, axis=0) for term in TERMS])


@pytest.mark.truth
@pytest.mark.parametrize(("degree", "counts"), [(1, (14, 11, 8)), (2, (38, 29, 20)), (3, (78, 59, 40))])
def test_number_of_unknowns(degree: int, counts: tuple[int, ...]) -> None:
    found = tuple(len(RfmForm(degree, word)) for word in ("separate", "common", "one"))
    assert found == counts
    assert all(len(RfmForm(degree, word).names) == len(RfmForm(degree, word)) for word in ("separate", "common", "one"))


@pytest.mark.truth
def test_names_follow_the_published_order() -> None:
    assert " ".join(RfmForm(1).names) == "a000 a100 a010 a001 b100 b010 b001 c000 c100 c010 c001 d100 d010 d001"
    assert RfmForm(3).names[10:20] == tuple(f"a{e}" for e in "111 030 210 012 120 300 102 021 201 003".split())
    assert RfmForm(1, "common").names[-3:] == ("b100", "b010", "b001")


@pytest.mark.oracle
@pytest.mark.parametrize("denominators", ["separate", "common", "one"])
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_jacobian_by_difference_quotients(degree: int, denominators: str, rng: np.random.Generator) -> None:
    form = RfmForm(degree, denominators)  # type: ignore[arg-type]
    m = form.monomials(rng.uniform(-1.0, 1.0, (5, 3)))
    x, h = 0.02 * rng.standard_normal(len(form)), 1e-6
    found = form.jacobian(x, m)
    for k, step in enumerate(h * np.eye(len(form))):
        quotient = (form.image(x + step, m) - form.image(x - step, m)) / (2.0 * h)
        np.testing.assert_allclose(found[:, k], np.concatenate([quotient[:, 1], quotient[:, 0]]), atol=1e-8)


@pytest.mark.oracle
@pytest.mark.parametrize("denominators", ["separate", "common", "one"])
def test_coefficients_project_like_the_polynomials_term_by_term(denominators: str, rng: np.random.Generator) -> None:
    form = RfmForm(3, denominators)  # type: ignore[arg-type]
    ground, x = rng.uniform(-1.0, 1.0, (7, 3)), 0.02 * rng.standard_normal(len(form))
    line, line_below, sample, sample_below = form.coefficients(x) @ terms_at(ground)
    expected = np.stack([line / line_below, sample / sample_below], axis=1)
    np.testing.assert_allclose(rfm.values(form.coefficients(x), ground), expected, rtol=1e-12)
    np.testing.assert_allclose(form.image(x, form.monomials(ground)), expected, rtol=1e-12)


@pytest.mark.oracle
def test_linear_form_is_the_true_one_times_its_denominator(rng: np.random.Generator) -> None:
    """The linear form is the numerator minus the measured coordinate times the denominator, term by term."""
    form = RfmForm(2)
    ground, x = rng.uniform(-1.0, 1.0, (9, 3)), 0.02 * rng.standard_normal(len(form))
    image = rng.uniform(-1.0, 1.0, (9, 2))
    design, observed = form.design(form.monomials(ground), image)
    line, line_below, sample, sample_below = form.coefficients(x) @ terms_at(ground)
    expected = np.concatenate([sample - image[:, 1] * sample_below, line - image[:, 0] * line_below])
    np.testing.assert_allclose(design @ x - observed, expected, atol=1e-14)


@pytest.mark.consistency
def test_kept_coefficients_are_those_of_the_complete_form(rng: np.random.Generator) -> None:
    form, some = RfmForm(2), (0, 1, 2, 3, 12, 19, 20, 21, 22)
    kept = RfmForm(2, kept=some)
    assert kept.names == tuple(form.names[k] for k in some)
    x = np.zeros(len(form))
    x[list(some)] = rng.standard_normal(len(some))
    np.testing.assert_array_equal(kept.coefficients(x[list(some)]), form.coefficients(x))
