"""The choice of jitter is tested: levels, planted jitter, records, refusals, gross errors, and the stored proof."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

import fg_orient as fg
from benchmarks import jitter as pairs
from fg_orient.model.block import Block
from fg_orient.model.distributions import INSIDE_95
from fg_orient.model.errors import InputError
from fg_orient.orientation.solution import Solution
from fg_orient.quality.jitter import choose, step
from fg_orient.quality.jitter_system import JitterSystem, Strength, without_quadratic
from fg_orient.simulate.simulation import Truth
from fg_orient.simulate.zonguldak import ZonguldakOptions, simulate_zonguldak
from tests.support.command import in_process


@pytest.fixture(scope="module")
def solution(made: tuple[Block, Truth]) -> Solution:
    return fg.adjust(made[0], jitter="auto")


@pytest.mark.oracle
def test_probabilities_are_uniform_without_further_jitter(system: JitterSystem) -> None:
    """Without further jitter the probability of another curve is uniform by Kolmogorov's test at 0.1 %.

    Observations are drawn from the model with one curve.
    """
    rng, current = np.random.default_rng(8), (Strength(1, 8, 0.8),)
    design, _ = system.bordered(current)
    priors = system.design.shape[1]  # the last rows of A
    p = []
    for _ in range(40):
        unknowns = rng.standard_normal(design.shape[1])
        y = (design @ unknowns)[: len(system.design)] + rng.standard_normal(len(system.design))
        y[-priors:] = 0.0  # priors are observations of zero
        p.append(step(replace(system, observed=y), current, rng).p)
    assert stats.kstest(p, "uniform").pvalue > 1e-3


@pytest.mark.oracle
def test_planted_jitter_is_found_where_it_is(made: tuple[Block, Truth], solution: Solution) -> None:
    """Planted jitter is found in its image and angle, with its amplitude, band and better ground points.

    Pitch of the left image has three cycles.
    """
    assert solution.jitter is not None
    block, truth = made
    (curve,) = solution.jitter.curves
    assert (curve.image, curve.angle) == ("left", "pitch")
    own = next(angle for angle in solution.jitter.angles if angle.band is not None)
    band = own.band
    assert band is not None
    wave = truth.corrections[0].waves[0]
    true = without_quadratic(band.tau, wave.at(band.tau)) * own.px_per_rad
    assert own.amplitude_px == pytest.approx(np.sqrt(2.0 * np.mean(true**2)), rel=0.15)
    assert np.mean(np.abs(band.value - true) <= INSIDE_95 * band.sd) > 0.8  # of one pair; the proof has 1000
    in_solution = without_quadratic(band.tau, solution.correction("left").eop_at(band.tau)[:, 7]) * own.px_per_rad
    assert np.abs(in_solution - band.value).max() < 1e-3
    plain = fg.adjust(block)
    assert solution.sigma0 < 0.8 * plain.sigma0
    errors = [np.sqrt(np.nanmean((one.ground_m - truth.ecef_m) ** 2)) for one in (solution, plain)]
    assert errors[0] < errors[1]


@pytest.mark.behaviour
def test_record_sentences_and_replacement(made: tuple[Block, Truth], solution: Solution) -> None:
    jitter = solution.jitter
    assert jitter is not None
    record = jitter.as_dict()
    assert [one["verdict"] for one in record["angles"]] == ["not found", "found", "not found", "not found"]
    assert record["angles"][1]["sentence"].startswith("pitch of left: jitter with an amplitude of 1.")
    assert "an amplitude above" in record["angles"][0]["sentence"]
    assert [one["p"] <= record["level"] for one in record["steps"]] == [True, False]
    assert {f.code for f in solution.findings} >= {"jitter.found", "jitter.not_found"}
    options = solution.block.options
    assert options.jitter == "auto" and options.jitter_curves == tuple(map(str, jitter.curves))
    again = fg.adjust(made[0], jitter_curves=options.jitter_curves)
    assert np.array_equal(again.state.image, solution.state.image)
    repeated = fg.adjust(solution.block)  # with jitter auto, the curves are chosen again
    assert repeated.block.options.jitter_curves == options.jitter_curves


@pytest.mark.behaviour
def test_few_points_cannot_tell(made: tuple[Block, Truth]) -> None:
    """With three control points the verdict on roll is ``cannot be told``, with the share that points absorb."""
    block = made[0]
    gone = np.zeros(len(block.points.ids), bool)
    gone[block.points.where(fg.Role.CONTROL)[3:]] = True
    few = replace(block, points=block.points.without_coordinates(gone, fg.Role.TIE))
    jitter = fg.adjust(few, jitter="auto").jitter
    assert jitter is not None
    told = {(angle.image, angle.angle): angle for angle in jitter.angles}
    for image in ("left", "right"):
        assert told[image, "roll"].verdict == "cannot be told" and told[image, "roll"].absorbed_by_points > 0.8
        assert "cannot be told" in told[image, "roll"].sentence and np.isnan(told[image, "roll"].bound_px)


@pytest.mark.behaviour
def test_gross_errors_are_not_jitter(made: tuple[Block, Truth]) -> None:
    """A gross error of 20 px is rejected and not taken for jitter, and the planted jitter is still found."""
    block = made[0]
    line = block.observations.line.copy()
    line[5] += 20.0
    spoiled = replace(block, observations=replace(block.observations, line=line))
    found = fg.adjust(spoiled, jitter="auto", snoop=True)
    assert found.snooping is not None and len(found.snooping.found) == 1
    assert found.jitter is not None
    assert [(c.image, c.angle) for c in found.jitter.curves] == [("left", "pitch")]
    assert found.block.options.snoop


REFUSED = {
    "left:roll:16": "IMAGE:ANGLE:INTERVALS:SIGMA",
    "left:yaw:16:1e-6": "roll or pitch",
    "left:roll:1:1e-6": "2 to 32",
    "left:roll:x:1e-6": "IMAGE:ANGLE",
    "left:roll:8:-1e-6": "sigma in rad",
    "other:roll:8:1e-6": "images of the block: left, right",
    "left:roll:8:1e-6,left:roll:8:2e-6": "name each angle once",
    "left:roll:8:1e-6,left:pitch:9:2e-6": "same number of intervals",
}


@pytest.mark.behaviour
@pytest.mark.parametrize("curves", REFUSED)
def test_wrong_curves_are_refused(made: tuple[Block, Truth], curves: str) -> None:
    with pytest.raises(InputError, match=REFUSED[curves]):
        fg.adjust(made[0], jitter_curves=tuple(curves.split(",")))


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"loss": "huber"}, "needs least squares"),
        ({"regularisation": "tikhonov"}, "needs least squares"),
        ({"variance_components": ("image",)}, "needs least squares"),
        ({"curve_intervals": 4}, "needs least squares"),
        ({"priors": False}, "needs priors"),
        ({"eop_set": "PU"}, "choose an EOP set with the attitude"),
        ({"eop_set": "PUA0"}, "choose an EOP set with the attitude"),
    ],
)
def test_options_that_exclude_the_evidence(made: tuple[Block, Truth], options: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        fg.adjust(made[0], jitter="auto", **options)


@pytest.mark.behaviour
def test_curves_exclude_smooth_curves(made: tuple[Block, Truth]) -> None:
    with pytest.raises(InputError, match="either smooth curves or jitter curves"):
        fg.adjust(made[0], jitter_curves=("left:roll:8:1e-6",), curve_intervals=4)


@pytest.mark.behaviour
def test_command_writes_table_section_and_record(tmp_path: Path) -> None:
    simulate_zonguldak(tmp_path / "twin", ZonguldakOptions(jitter_px=1.5, jitter_images=("right",), jitter_axis="roll"))
    out = tmp_path / "out"
    ended = in_process("adjust", tmp_path / "twin" / "project.toml", "--jitter", "auto", "--out", out, "--json")
    assert ended.code == 0
    record = ended.json["jitter"]
    assert [one["verdict"] for one in record["angles"]].count("found") == 1
    result = fg.read_result(out)
    table = result.tables["jitter"]
    assert set(table.words["image"]) == {"right"} and set(table.words["component"]) == {"roll"}
    line, value, sd, low, high = table.numbers("line", "value_px", "sd_px", "lower_px", "upper_px").T
    assert line[0] == 0.0 and line[-1] == 11999.0
    np.testing.assert_allclose([low, high], [value - INSIDE_95 * sd, value + INSIDE_95 * sd])
    page = (out / "report.html").read_text("utf-8")
    assert "Test for jitter of roll and pitch" in page and "jitter of roll of image right over the lines" in page
    assert in_process("replay", out).code == 0
    located = in_process("locate", tmp_path / "twin" / "right.DIM", "--line", 6000, "--sample", 6000, "--height", 300,
                         "--result", out, "--json")  # fmt: skip
    assert located.code == 0, located.stderr
    without = fg.adjust(fg.read_project(tmp_path / "twin" / "project.toml"), jitter_curves=("right:pitch:4:1e-9",))
    assert without.jitter is None


@pytest.mark.oracle
def test_stored_proof_meets_its_bounds(repository: Path) -> None:
    """The stored 1000 pairs with and 1000 without jitter meet the bounds, and docs/jitter.md has their table.

    ``python -m benchmarks.jitter`` makes them.
    """
    stored = json.loads(pairs.RESULTS.read_text("utf-8"))
    found = pairs.figures(stored["without"], stored["with"])
    assert (found["pairs_without"], found["pairs_with"]) == (1000, 1000)
    assert found["false_upper_bound"] <= 0.03
    assert abs(found["amplitude"]["mean_ratio"] - 1.0) <= 0.10
    assert 0.93 <= found["coverage"] <= 0.97
    for accuracy in (found["accuracy"], found["accuracy_without"]):
        assert max(one["pooled_ratio"] for one in accuracy.values()) <= 1.02
    assert max(one["pooled_ratio"] for one in found["accuracy_by_amplitude"]) <= 1.02
    assert pairs.tables(found) in (repository / "docs" / "jitter.md").read_text("utf-8")


@pytest.mark.oracle
def test_upper_bound_is_that_of_scipy() -> None:
    bound = stats.binomtest(11, 1000, alternative="less").proportion_ci(0.95, "exact").high
    assert pairs.upper_bound(11, 1000) == pytest.approx(bound, rel=1e-9)


@pytest.mark.slow
@pytest.mark.oracle
def test_pairs_with_and_without_jitter() -> None:
    """40 other pairs of each kind meet the bounds of the proof, widened by three standard errors."""
    seeds = range(5000, 5040)
    found = pairs.figures([pairs.run(k, False) for k in seeds], [pairs.run(k, True) for k in seeds])
    assert found["false_finds"] <= stats.binom.ppf(0.999, 40, 0.02)
    amplitude = found["amplitude"]
    assert abs(amplitude["mean_ratio"] - 1.0) <= 0.10 + 3.0 * amplitude["se"]
    assert 0.93 - 3.0 * found["coverage_se"] <= found["coverage"] <= 0.97 + 3.0 * found["coverage_se"]
    assert found["accuracy"]["free"]["pooled_ratio"] <= 1.02
    assert found["found"] >= 0.5 * found["angles_with_jitter"]


@pytest.mark.consistency
def test_a_stored_run_is_repeated() -> None:
    """A pair of the proof gives the stored verdicts again. Random numbers do not depend on the machine."""
    stored = json.loads(pairs.RESULTS.read_text("utf-8"))["with"][1]
    again = pairs.run(1, True)
    assert [(a["angle"], a["verdict"]) for a in again["angles"]] == [
        (a["angle"], a["verdict"]) for a in stored["angles"]
    ]
    for one, other in zip(again["angles"], stored["angles"], strict=True):
        assert one["true_px"] == pytest.approx(other["true_px"], rel=1e-3)
    assert choose  # the choice is part of the run
