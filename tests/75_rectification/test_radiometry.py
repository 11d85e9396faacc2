"""Destriping, dark object and classification errors: planted effects are found, a published matrix repeated."""

from __future__ import annotations

import numpy as np
import pytest

from fg_orient.model.errors import InputError
from fg_orient.rectification import classification_errors, destripe, subtract_dark_object


@pytest.mark.truth
def test_error_matrix_of_congalton() -> None:
    """The error matrix of Congalton (1991), table 1, has the printed accuracies of four classes."""
    counts = np.array([[65, 4, 22, 24], [6, 81, 5, 8], [0, 11, 85, 19], [4, 7, 3, 90]])
    names = np.array(["1 deciduous", "2 conifer", "3 agriculture", "4 shrub"])
    rows, columns = (np.repeat(index.ravel(), counts.ravel()) for index in np.indices(counts.shape))
    found = classification_errors(names[rows], names[columns])
    assert found.classes == tuple(names) and np.array_equal(found.counts, counts)
    assert np.round(100.0 * (1.0 - found.omission)).tolist() == [87, 79, 74, 64]  # producer's accuracy
    assert np.round(100.0 * (1.0 - found.commission)).tolist() == [57, 81, 74, 87]  # user's accuracy
    assert round(100.0 * found.correct) == 74


@pytest.mark.oracle
def test_agreement_by_chance_is_none(rng: np.random.Generator) -> None:
    """Independent classes have kappa 0 within its spread, and the share correct has the stated sigma."""
    runs = [classification_errors(*rng.integers(0, 4, (2, 500))) for _ in range(200)]
    assert abs(np.mean([run.kappa for run in runs])) < 4.0 / np.sqrt(500 * 200)
    spread = np.std([run.correct for run in runs]) / np.mean([run.sigma_correct for run in runs])
    assert abs(spread - 1.0) < 4.0 / np.sqrt(2 * 200)


@pytest.mark.truth
def test_classes_that_do_not_occur_have_no_error() -> None:
    found = classification_errors([0, 0, 1], [0, 2, 2])
    assert found.omission.tolist() == pytest.approx([0.0, np.nan, 1.0], nan_ok=True)
    assert found.commission.tolist() == pytest.approx([0.5, 1.0, np.nan], nan_ok=True)
    assert np.isnan(classification_errors([1, 1], [1, 1]).kappa)


@pytest.mark.oracle
def test_planted_stripes_are_removed(rng: np.random.Generator) -> None:
    """Destriping removes gains and offsets of six detectors up to the sampling error of their moments."""
    scene = rng.normal(100.0, 20.0, (600, 400))
    gain, offset = rng.uniform(0.8, 1.2, 6), rng.uniform(-10.0, 10.0, 6)
    which = (2 + np.arange(600)) % 6
    striped = gain[which, None] * scene + offset[which, None]
    striped[5, 7], valid = np.nan, np.ones(scene.shape, bool)
    valid[100:110] = False
    found = destripe(striped, valid=valid, first_detector=2)
    means, spreads = (np.array([f(found[(which == k)[:, None] & valid & np.isfinite(striped)]) for k in range(6)])
                      for f in (np.mean, np.std))  # fmt: skip
    assert np.ptp(means) < 1e-9 and np.ptp(spreads) < 1e-9
    assert np.array_equal(found[100:110], striped[100:110]) and np.isnan(found[5, 7])
    used = valid & np.isfinite(striped)
    slope, shift = np.polyfit(scene[used], found[used], 1)  # one line for all detectors
    left = found[used] - slope * scene[used] - shift
    # mean and standard deviation of 40 000 pixels: 1/sqrt(n) and 1/sqrt(2 n) of a sigma of 20
    assert np.abs(left).max() < 5.0 * 20.0 * (1.0 + 4.5 / np.sqrt(2.0)) / np.sqrt(40_000)
    assert np.std(striped[used] - slope * scene[used] - shift) > 5.0


@pytest.mark.truth
def test_planted_haze_is_subtracted() -> None:
    """The dark object is water with the value 12, not two dead pixels with 3, and is subtracted."""
    band = np.full((20, 20), 60.0)
    band[:5], band[7, 7], band[8, 8], band[9, 9] = 12.0, 3.0, 3.0, np.nan
    found, dark = subtract_dark_object(band, least_pixels=10)
    assert dark == 12.0 and (found[:5] == 0.0).all() and found[7, 7] == 0.0 and found[10, 10] == 48.0
    assert np.isnan(found[9, 9]) and subtract_dark_object(band)[1] == 3.0
    assert subtract_dark_object(band, valid=band > 50.0)[1] == 60.0


@pytest.mark.behaviour
def test_bad_input_is_refused() -> None:
    band = np.arange(24.0).reshape(6, 4)
    with pytest.raises(InputError, match="detector 5"):
        destripe(np.where(np.arange(6)[:, None] == 5, 1.0, band))
    with pytest.raises(InputError, match="image"):
        destripe(np.zeros(3))
    with pytest.raises(InputError, match="valid"):
        destripe(band, 2, valid=np.ones((2, 2), bool))
    with pytest.raises(InputError, match="24"):
        subtract_dark_object(band, least_pixels=25)
    with pytest.raises(InputError, match="shapes"):
        classification_errors([1, 2], [1])
