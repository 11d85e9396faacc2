"""The real Pléiades pair is adjusted with ten of 86 points as control, beginning with each point in turn.

Bounds of the issue; an independent bundle gave medians 0.45-0.48 / 0.52-0.57 / 2.01-2.15 m.
"""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from tests.support.examples import check_shown
from tests.support.pages import run_script

pytestmark = pytest.mark.real_data

AXES = ("east", "north", "up")
#: Sets with bounds of their own.
MEASURED = (2, 10)


@pytest.fixture(scope="module")
def example(repository: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("pleiades_pair", repository / "examples" / "pleiades_pair.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def rmse(example: ModuleType, real_data: Path, every: int) -> dict[int, np.ndarray]:
    """Return check-point RMSE (n, 3) of each set in each ``every``-th of the 86 runs.

    Sets 2 and 10 have twice as many runs.
    """
    scene = example.Scene(real_data / "geoetrim-pleiades")
    assert len(scene.ids) == 86
    out = {}
    for eop_set in example.SETS:
        step = (every + 1) // 2 if eop_set in MEASURED else every
        runs = [example.run(scene, first, eop_set, 0.3) for first in range(0, 86, step)]
        # point 244 (2 m off) may be suspected among the ten control points; check points contradict in some runs
        doubted = [r["reason"] for r in runs if r["status"] != "converged"]
        # the coordinates, stated as 0.3 m, are as good as the check points: 0.5 m
        known = ("check points contradict", "stated standard deviations are too small")
        suspected = [reason for reason in doubted if not any(words in reason for words in known)]
        assert all("gross error" in reason for reason in suspected), suspected
        assert sum("point 244" not in reason for reason in suspected) <= 2, suspected  # of 86 runs, 0.2 % by chance
        out[eop_set] = np.array([[r[f"rmse_{axis}_m"] for axis in AXES] for r in runs])
    return out


@pytest.mark.truth
@pytest.mark.parametrize("every", [pytest.param(1, marks=pytest.mark.slow), 24])
def test_medians_and_maxima(example: ModuleType, real_data: Path, every: int) -> None:
    found = rmse(example, real_data, every)
    median = {k: np.median(v, axis=0) for k, v in found.items()}
    for eop_set in MEASURED:
        assert np.all(median[eop_set] <= [0.50, 0.60, 2.15]), (eop_set, median[eop_set])
    for eop_set in (9, 16, 1, 15):
        assert np.all(median[eop_set] <= 1.2 * median[10]), (eop_set, median[eop_set])
    for eop_set, values in found.items():
        assert np.all(values.max(axis=0) <= [0.70, 0.80, 3.5]), (eop_set, values.max(axis=0))


@pytest.mark.truth
def test_direct_geolocation_is_off_by_eight_metres(example: ModuleType, real_data: Path) -> None:
    direct = example.direct_geolocation(example.Scene(real_data / "geoetrim-pleiades"))
    assert direct["rmse_horizontal_m"] == pytest.approx(8.1, abs=0.3)
    assert direct["sd_east_m"] < 1.0


@pytest.mark.behaviour
def test_too_small_sigmas_are_called_untrustworthy(example: ModuleType, real_data: Path) -> None:
    """With sigmas of 0.05 m sigma0 is 1.9 and each run is not trustworthy.

    0.05 m is the accuracy of the survey, not of identification.
    """
    scene = example.Scene(real_data / "geoetrim-pleiades")
    runs = [example.run(scene, first, 10, 0.05) for first in range(0, 86, 10)]
    assert np.median([r["sigma0"] for r in runs]) == pytest.approx(1.9, abs=0.2)
    assert all(r["status"] == "not_trustworthy" for r in runs)
    assert "must not be trusted" in runs[0]["reason"]


@pytest.mark.behaviour
def test_example_prints_one_json_object(repository: Path, real_data: Path) -> None:
    command = (repository / "examples" / "pleiades_pair.py", real_data / "geoetrim-pleiades", "--first")
    done = run_script(*command, "3", "--json")
    assert done.code == 0, done.stderr
    out = json.loads(done.stdout)
    assert set(out["sets"]) == {"2", "10", "9", "16", "1", "15"}
    assert out["details"]["10"]["first"] == "3"
    assert len(out["details"]["10"]["largest"]) == 5
    assert all(row["ratio"] > 3.0 for row in out["details"]["10"]["beyond_3_sigma"])
    text = run_script(*command, "3")
    assert text.code == 0, text.stderr
    check_shown(repository, "pleiades_pair.py", text)
    unknown = run_script(*command, "nosuch")
    assert unknown.code != 0
    assert "no point nosuch" in unknown.stderr
