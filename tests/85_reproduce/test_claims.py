"""The claims of a faithful reproduction are tested over seeds of the twin."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from scipy import stats

from fg_orient.studies import claims
from fg_orient.studies.claims import Claim, all_claims, outcome, run_claims, wilson
from fg_orient.studies.switches import PROGRAM

IDS = [f"C{k}" for k in range(1, 23)]
#: Claims of which a part depends on the rounding of one elimination: judged over 30 seeds only.
ROUNDING = {"C8", "C12", "C14", "C18", "C21"}
#: Parts met in fewer than 90 % of the seeds. C8: half of the time all eliminations share the last, meaningless pivot.
#: C18, C21: the limits are those of one or two seeds; the real points meet them (tables 4.44 and 4.45).
NOT_MET = {
    "C8": {"V of set 19 disagrees"},
    "C18": {"Cramer, degree 1", "elimination, linear form", "pseudo-inverse 1-100 px", "elimination, image"},
    "C21": {"raw > 10 px"},
}


#: A part that is met in 90 % of the seeds has more failures in 30 seeds than this number once
#: in a thousand times. Which elimination meets a meaningless pivot differs between the
#: kernels of OpenBLAS: V of set 5 failed in 0 to 4 of the same 30 seeds.
MOST_FAILURES = int(stats.binom.ppf(0.999, 30, 0.1))

#: Parts that may fail in a single seed; all other parts are met in every seed.
MAY_FAIL = NOT_MET | {
    "C12": {"four of five above 100 m", "their check points within 0.5 m"},
    "C14": {"OD: control points"},
}


MATRICES = ("short_axis", "small_angles")
#: Claims that the authors' program does not meet, and the switches without which it does (C8: as often as the text).
DEPENDS_ON = {
    "C4": (*MATRICES, "test_after"), "C8": (*MATRICES, "test_after"), "C9": MATRICES, "C10": MATRICES,
    "C13": ("complex_roots",), "C14": (*MATRICES, "metadata_positions"),
}  # fmt: skip


@pytest.mark.behaviour
def test_every_claim_is_there_once() -> None:
    assert [c.id for c in all_claims()] == IDS


@pytest.fixture(scope="module")
def one_seed() -> dict[str, claims.ClaimResult]:
    return {r.id: r for r in run_claims((3,))}


@pytest.mark.truth
@pytest.mark.parametrize("name", [i for i in IDS if i not in ROUNDING])
def test_claim_holds(one_seed: dict[str, claims.ClaimResult], name: str) -> None:
    result = one_seed[name]
    assert result.passed == result.of == 1, (result.reason, result.figures)


@pytest.mark.truth
@pytest.mark.parametrize("name", sorted(ROUNDING))
def test_rounding_claim_fails_only_in_parts_that_are_rounding(
    one_seed: dict[str, claims.ClaimResult], name: str
) -> None:
    result = one_seed[name]
    failed = {part.rpartition(": not in ")[0] for part in filter(None, result.reason.split("; "))}
    assert failed <= MAY_FAIL[name]
    assert result.passed == (0 if failed else 1)


@pytest.mark.truth
@pytest.mark.slow
@pytest.mark.parametrize("first", [1, 31])
def test_claims_over_thirty_seeds(first: int, capsys: pytest.CaptureFixture[str]) -> None:
    results = run_claims(range(first, first + 30))
    with capsys.disabled():
        print(f"\nseeds {first}-{first + 29}")
        for r in results:
            print(f"{r.id:4s} {r.passed:2d}/{r.of}  {r.interval[0]:.2f}-{r.interval[1]:.2f}  {r.reason}")
    missed = {r.id: r.reason for r in results if not r.met}
    assert NOT_MET.keys() <= missed.keys() <= ROUNDING, missed
    for name, reason in missed.items():
        counts = re.findall(r"([^;]+): not in (\d+) of 30", reason.replace("; ", ";"))
        parts = NOT_MET.get(name, set())
        assert name not in NOT_MET or {part for part, _ in counts} & parts, reason
        failed = {part for part, count in counts if int(count) > MOST_FAILURES}
        assert failed <= parts, reason  # every other part is met


@pytest.mark.behaviour
@pytest.mark.parametrize("name", ["C4", "C9", "C10"])
def test_claims_about_the_text_depend_on_switches_of_the_program(name: str) -> None:
    """Claims about the text fail with the switches of the program and hold without those behind them.

    These are the claims that rounding does not decide, on one seed with the same bounds.
    """
    chosen = [claim for claim in all_claims() if claim.id == name]
    (program,) = run_claims((3,), claims=chosen, switches=PROGRAM)
    (without,) = run_claims((3,), claims=chosen, switches=PROGRAM.without(*DEPENDS_ON[name]))
    assert (program.passed, without.passed) == (0, 1), (program.reason, without.reason)


@pytest.mark.truth
@pytest.mark.slow
def test_claims_of_the_program_over_thirty_seeds() -> None:
    """Over thirty seeds the program misses exactly the listed claims, each because of its switches.

    The claims are C1 to C16 and C22, with the same bounds.
    """
    about = {claim.id: claim for claim in all_claims() if claim.id not in {f"C{k}" for k in range(17, 22)}}
    results = {r.id: r for r in run_claims(range(1, 31), claims=list(about.values()), switches=PROGRAM)}
    missed = {name for name, r in results.items() if not r.met}
    assert missed - ROUNDING == set(DEPENDS_ON) - {"C8", "C14"}
    assert {"C8", "C14"} <= missed
    for name, switches in DEPENDS_ON.items():
        (r,) = run_claims(range(1, 31), claims=[about[name]], switches=PROGRAM.without(*switches))
        failed = {part for part, count in re.findall(r"([^;]+): not in (\d+) of 30", r.reason.replace("; ", ";"))
                  if int(count) > MOST_FAILURES}  # fmt: skip
        assert failed <= NOT_MET.get(name, set()), (name, r.reason)


@pytest.mark.truth
@pytest.mark.slow
def test_mean_check_point_rmse() -> None:
    # the other half of C5: the mean over the seeds lies at 5-8 m per axis
    rmse = []
    for seed in range(1, 31):
        found = claims_geometry_c5(seed)
        rmse.append([found["x_m"], found["y_m"], found["z_m"]])
    mean = np.mean(rmse, axis=0)
    assert ((mean >= 5.0) & (mean <= 8.0)).all(), mean


def claims_geometry_c5(seed: int) -> dict[str, float]:
    from fg_orient.studies.claims import Study
    from fg_orient.studies.claims_geometry import _c5

    return _c5(Study(seed)).figures


@pytest.mark.behaviour
def test_a_claim_that_fails_is_reported_with_its_part() -> None:
    def judge(study: object) -> claims.Outcome:
        seed = study.seed  # type: ignore[attr-defined]
        return outcome({"even": seed % 2 == 0, "always": True}, seed=seed)

    (result,) = run_claims(range(1, 6), claims=[Claim("X", "every seed is even", judge)])
    assert (result.passed, result.of, result.met) == (2, 5, False)
    assert result.reason == "even: not in 3 of 5"
    assert result.figures == {"seed": (1.0, 3.0, 5.0)}


@pytest.mark.oracle
@pytest.mark.parametrize(("passed", "of"), [(0, 10), (27, 30), (30, 30), (1, 1)])
def test_wilson_interval_inverts_the_score_test(passed: int, of: int) -> None:
    low, high = wilson(passed, of)
    assert 0.0 <= low <= passed / of <= high <= 1.0
    z = stats.norm.ppf(0.975)
    for bound in (low, high):
        if 0.0 < bound < 1.0:
            assert abs(passed / of - bound) == pytest.approx(z * math.sqrt(bound * (1.0 - bound) / of), rel=1e-9)
    with pytest.raises(ValueError, match="at least one"):
        wilson(0, 0)


@pytest.mark.behaviour
def test_progress_is_told() -> None:
    seen: list[tuple[int, int]] = []
    run_claims((1, 2), lambda done, of: seen.append((done, of)), claims=[Claim("X", "", lambda s: outcome({"": True}))])
    assert seen == [(1, 2), (2, 2)]
