"""Claims C17-C21: the sensor-independent RFM, raw and normalised, on 99 points of the twin's left image."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from fg_orient.adjustment.linear.conditioning import diagnose
from fg_orient.rpc.estimate import fit_linear
from fg_orient.rpc.form import DEGREES, RfmForm
from fg_orient.studies.claims import Claim, Outcome, outcome
from fg_orient.studies.rfm_twin import rfm_points
from fg_orient.studies.study import Study
from fg_orient.studies.tables_spot6 import CRAMER, METHODS, Run

PSEUDO, PIVOT = "moore_penrose_inverse", "gauss_partial_pivot_elimination"
RULES = ("tikhonov_hkb", "tikhonov_lw", "tikhonov_od")
#: Ranks of the raw systems, and how far another set of points may be from them.
RANKS, RANK_SLACK = {1: 10, 2: 18, 3: 20}, 3
#: Condition numbers of the normalised N.
CONDITIONS = {1: (1e1, 1e3), 2: (1e9, 1e11), 3: (1e10, 1e13)}
N_CHECK = 400


@lru_cache(maxsize=8)
def _runs(study: Study) -> dict[tuple[int, bool], Run]:
    """Systems of one seed by degree and normalisation."""
    points = rfm_points(study.two_stage.block.images[0].sensor, study.seed)
    return {(degree, normalised): Run(points, degree, normalised) for degree in DEGREES for normalised in (False, True)}


def _image_rms(run: Run, method: str) -> float:
    """RMS of the true image residuals, both axes; inf where there is no solution."""
    value = run.true_m0_px(run.solution(method).x)
    share = run.system.redundancy / (2.0 * len(run.points))
    return value * share**0.5 if np.isfinite(value) else np.inf


def _m0(run: Run, method: str) -> float:
    """Accuracy m0 of the linear form; inf where there is no solution."""
    value = run.m0_px(run.solution(method).x)
    return value if np.isfinite(value) else np.inf


def c17(study: Study) -> Outcome:
    """Raw systems lack rank in every degree."""
    ranks = {d: diagnose(_runs(study)[d, False].system).rank for d in DEGREES}
    checks = {f"degree {d}": abs(rank - RANKS[d]) <= RANK_SLACK for d, rank in ranks.items()}
    return outcome(checks, **{f"rank_{d}": rank for d, rank in ranks.items()})


def c18(study: Study) -> Outcome:
    """Raw systems: Cramer wild, pseudo-inverse moderate, eliminations good in the linear form only."""
    raw = {d: _runs(study)[d, False] for d in DEGREES}
    cramer = {d: _m0(raw[d], CRAMER) for d in (1, 2)}
    pseudo = {d: _m0(raw[d], PSEUDO) for d in DEGREES}
    pivot = {d: (_m0(raw[d], PIVOT), _image_rms(raw[d], PIVOT)) for d in (2, 3)}
    checks = {
        "Cramer, degree 1": cramer[1] > 1e3, "Cramer, degree 2": cramer[2] > 1e10,
        "pseudo-inverse 1-100 px": all(1.0 <= value <= 100.0 for value in pseudo.values()),
        "elimination, linear form": all(linear < 0.1 for linear, _ in pivot.values()),
        "elimination, image": all(image > 3.0 for _, image in pivot.values()),
    }  # fmt: skip
    figures = {f"cramer_{d}_px": v for d, v in cramer.items()} | {f"pseudo_{d}_px": v for d, v in pseudo.items()}
    return outcome(checks, **figures, **{f"pivot_image_{d}_px": image for d, (_, image) in pivot.items()})


def c19(study: Study) -> Outcome:
    """Normalised systems: full rank, all solvers but Cramer agree, m0 falls with the degree."""
    runs = {d: _runs(study)[d, True] for d in DEGREES}
    found = {d: diagnose(run.system) for d, run in runs.items()}
    m0 = {d: _m0(runs[d], PIVOT) for d in DEGREES}
    others = [method for method in METHODS if method != CRAMER]
    spread = max(abs(_m0(runs[d], method) / m0[d] - 1.0) for d in DEGREES for method in others)
    cramer = min(_m0(runs[d], CRAMER) / m0[d] for d in (2, 3))
    checks = {
        "full rank": all(f.defect == 0 for f in found.values()), "three digits": spread < 5e-3,
        "falls with the degree": m0[1] > m0[2] > m0[3], "Cramer fails": cramer > 10.0,
        "condition numbers": all(CONDITIONS[d][0] <= f.cond_norm <= CONDITIONS[d][1] for d, f in found.items()),
    }  # fmt: skip
    figures = {f"m0_{d}_px": v for d, v in m0.items()} | {f"cond_{d}": f.cond_norm for d, f in found.items()}
    return outcome(checks, spread=spread, cramer_ratio=cramer, **figures)


def c20(study: Study) -> Outcome:
    """Degree 3 with 99 points is over-parametrised: image residuals and check points are worse than m0 says."""
    run = _runs(study)[3, True]
    sensor = study.two_stage.block.images[0].sensor
    check = rfm_points(sensor, study.seed, count=N_CHECK, noise_px=0.0, stream=1)
    m0, image = _m0(run, PIVOT), _image_rms(run, PIVOT)
    fit = fit_linear(run.points, RfmForm(3), solver=PIVOT, allow_pole=True)
    at_check = float(np.sqrt(np.mean(fit.residuals_px(check) ** 2)))
    return outcome({"image": image > m0, "check points": at_check > m0}, m0_px=m0, image_px=image, check_px=at_check)


def c21(study: Study) -> Outcome:
    """Tikhonov cures no raw system of degree 2 or 3; OD harms the normalised ones."""
    runs = _runs(study)
    raw = min(_image_rms(runs[d, False], rule) for d in (2, 3) for rule in RULES)
    od = min(_image_rms(runs[d, True], "tikhonov_od") for d in (2, 3))
    return outcome({"raw > 10 px": raw > 10.0, "OD, normalised > 10 px": od > 10.0}, raw_px=raw, od_px=od)


CLAIMS = (
    Claim("C17", "raw RFM: rank deficient in every degree, about 10/18/20 of 14/38/78", c17),
    Claim("C18", "raw RFM: Cramer m0 > 1e3 and > 1e10 px, pseudo-inverse 1-100 px, partial pivoting good in the linear "
          "form only", c18),
    Claim("C19", "normalised RFM: full rank, all solvers but Cramer agree to 3 digits, m0 falls with the degree", c19),
    Claim("C20", "normalised RFM of degree 3: image residuals and check points exceed m0 of the linear form", c20),
    Claim("C21", "Tikhonov cures no raw RFM of degree 2 or 3; OD harms the normalised ones", c21),
)  # fmt: skip
