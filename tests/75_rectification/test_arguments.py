"""Impossible values for the helpers in Python are each refused with a message of the catalogue."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from fg_orient.model.errors import InputError
from fg_orient.rectification import projections, scanner, standards, study
from fg_orient.rectification.fit import Observations, fit
from fg_orient.rectification.grid import LevelSurface, MapGrid
from fg_orient.rectification.outliers import prune
from fg_orient.rectification.study import pair_distances
from fg_orient.rectification.transformation import find_model

pytestmark = pytest.mark.behaviour

BOX = np.array([[0.0, 0.0], [30.0, 0.0], [30.0, 20.0], [0.0, 20.0]])
GK = projections.gauss_krueger(27.0)
TM = scanner.Scanner(705e3, 42.5e-6, 42.5e-6)
M0S = {1: 2.0, 2: 1.5}
GROUND = Observations.of(
    np.random.default_rng(1).uniform(0.0, 1e3, (9, 2)), np.random.default_rng(2).uniform(0.0, 1e3, (9, 2))
)
NAN = float("nan")

#: Helper, arguments that it takes, and for each argument what it must refuse.
CASES: list[tuple[Callable[..., Any], tuple[Any, ...], tuple[tuple[Any, ...], ...]]] = [
    (projections.planar_area_m2, (BOX,), (([], BOX[:2], BOX[:, 0], [["a", "b"]] * 3, BOX * NAN),)),
    (projections.perimeter_m, (BOX,), (([], [[0.0, 1.0], [1.0]]),)),
    (projections.mean_spacing_m, (100.0, 4), ((-1.0, 0.0, NAN, "x"), (0, -3, NAN))),
    (projections.pixel_area_m2, (5, 30.0), ((-1, NAN), (0.0, -30.0, np.inf))),
    (projections.pixel_area_sigma_m2, (1e4, 30.0), ((-1.0, 0.0, NAN, []), (-30.0, NAN))),
    (projections.count_pixels, (BOX, 3.0, (0.0, 0.0)), (([],), (-3.0, NAN), ((NAN, 0.0), 0.0, (1.0, 2.0, 3.0)))),
    (scanner.Scanner, (7e5, 4e-5, 4e-5), ((-7e5, NAN, "high"), (0.0,), (-1.0,))),
    (scanner.total_angle_rad, (185e3, 705e3), ((-1.0, NAN), (0.0, -705e3))),
    (scanner.swath_m, (0.07, 8e5, 0.1, 6.4e6), ((0.0, -0.1), (-8e5, NAN), (NAN,), (-1.0, NAN))),
    (scanner.swath_m, (0.07, 8e5, 0.1), ((4.0,), (0.0,), (2.0,))),
    (scanner.error_budget, (1.0, 2.0), ((-1.0, NAN), (np.inf,))),
    (scanner.relief_shift_m, (100.0, 0.1), ((NAN, []), (NAN, 2.0))),
    (TM.element_m, (0.1, 5.0), ((1.6, NAN), (NAN,))),
    (TM.ground, (0.0, 0.1, 5.0), ((NAN, []), (np.inf,), (NAN,))),
    (TM.panoramic_shift_m, (0.1,), ((-1.58, NAN),)),
    (TM.mirror_shift_m, (0.1,), ((NAN, "x"),)),
    (standards.nmas_limit_m, (5e4,), ((0.0, -1.0, NAN),)),
    (standards.effective_resolution_m, (5e4,), ((0.0, NAN),)),
    (standards.cmas_m, (1.0, 1.0), ((-1.0, NAN), (np.inf,))),
    (standards.nssda_m, (1.0, 1.0), ((-1.0, NAN), (np.inf,))),
    (projections.utm, (35,), ((0, 61, 35.5),)),
    (projections.gauss_krueger, (27.0,), ((NAN, "x"),)),
    (projections.lambert_cylindrical, (6.37e6,), ((0.0, -1.0, NAN),)),
    (projections.lambert_polar, (6.37e6,), ((0.0, NAN),)),
    (projections.project, (GK, [29.0], [41.0]), (("+proj=no",), (NAN, [], [1.0, 2.0]), ("x", [[1.0]]))),
    (projections.unproject, (GK, [[1e5, 4e6]]), (("+proj=no",), ([], [[NAN, 1.0]], [[1.0]], [1.0, 2.0, 3.0]))),
    (projections.scale_factors, (GK, 29.0, 41.0), (("+proj=no",), (NAN,), (95.0, []))),
    (projections.ellipsoidal_area, ([29.0, 29.1, 29.0], [41.0, 41.0, 41.1]), (([29.0], [NAN] * 3), ([], ["a"] * 3))),
    (study.terms, (2,), ((-1, 1.5),)),
    (study.growing_degrees, (M0S, 30), (({1: -2.0}, {1: NAN}, {1: 0.0}), (3,))),
    (study.admissible_points, (M0S,), (({}, {1: NAN}),)),
    (study.design_study, (GROUND, GROUND, [5], [1]), ((), (), ([0], [10]), ([0], [9]))),
    (study.distance_ratios, (2, 1), ((1, -5), (-1,))),
    (study.digitised_sheets, ((5, 4), 2, 1), (((0, 4), (2, 2)), (1,), (-1,))),
    (pair_distances, (BOX, BOX), (([], BOX[:2], BOX * NAN), (BOX[:3], "x"))),
    (Observations.of, (BOX, BOX), (([], [[1.0], [2.0, 3.0]], BOX * NAN, BOX[:, :1]), (BOX[:3], [["a", "b"]] * 4))),
    (prune, (fit(GROUND, find_model("affine")), 1e9), ((), (0.0, -1.0, NAN))),
    (fit(GROUND, find_model("affine")).prediction_sigma, (BOX,), (([], BOX * NAN),)),
    (LevelSurface, (100.0,), ((NAN, np.inf),)),
    (MapGrid.over, ((0.0, 0.0, 10.0, 10.0), 1.0, ""), (((0.0, 0.0, 10.0), (0.0, NAN, 1.0, 1.0)), (0.0, -1.0, NAN))),
]  # fmt: skip


@pytest.mark.parametrize("case", CASES, ids=lambda case: case[0].__qualname__)
def test_nonsense_is_refused(case: tuple[Callable[..., Any], tuple[Any, ...], tuple[tuple[Any, ...], ...]]) -> None:
    helper, good, bad = case
    helper(*good)
    for place, values in enumerate(bad):
        for value in values:
            with pytest.raises(InputError) as caught:
                helper(*good[:place], value, *good[place + 1 :])
            assert caught.value.problems[0].code in {
                "rectify.numbers", "rectify.positive", "rectify.points", "rectify.outline", "rectify.projection",
                "rectify.outside", "rectify.counts", "rectify.degree", "rectify.few_points", "options.value",
                "argument.value",
            }, (place, value)  # fmt: skip


@pytest.mark.parametrize(
    "ask",
    [*(lambda n=n: study.design_study(GROUND, GROUND, [5], [1], layouts=n) for n in (0, -1, 2.5)),
     scanner.error_budget],
)  # fmt: skip
def test_a_study_needs_layouts_and_a_budget_errors(ask: Callable[[], object]) -> None:
    with pytest.raises(InputError):
        ask()
