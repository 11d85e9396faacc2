"""In the study of estimators the scenes have the stated truth, and the page is made from its rows."""

from __future__ import annotations

import json

import numpy as np
import pytest

from benchmarks.estimators import NOISE_PX, PAGE, RESULTS, page, run, scene
from fg_orient.adjustment.problem import State, compile_problem


@pytest.mark.truth
def test_residuals_at_the_truth_are_the_noise() -> None:
    """At the truth the mean squares of residuals and corrections are those stated, within four sigmas."""
    block, true_x, true_m = scene(1, 20, 3.0)
    problem = compile_problem(block)
    image = true_x.reshape(problem.start.image.shape)
    v = problem.pixel_residuals(State(image, true_m - problem.origin_m)) / NOISE_PX
    assert abs(float(np.mean(v**2)) - 1.0) <= 4.0 * np.sqrt(2.0 / v.size)
    assert abs(float(np.mean((true_x / 3.0) ** 2)) - 1.0) <= 4.0 * np.sqrt(2.0 / true_x.size)


@pytest.mark.behaviour
def test_a_refused_estimate_is_counted_and_a_right_one_is_close() -> None:
    assert run(1, 5, 1.0, "least squares") is None
    found = run(1, 5, 1.0, "priors")
    assert found is not None and 0.8 <= found["inside"] <= 1.0
    assert float(np.sqrt(found["squares"].max())) < 12.0


@pytest.mark.repository
def test_the_page_is_made_of_the_rows() -> None:
    assert PAGE.read_text("utf-8") == page(json.loads(RESULTS.read_text("utf-8")))
