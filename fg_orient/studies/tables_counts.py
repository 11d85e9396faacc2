"""Numbers of Terlemezoğlu (2019) that are counted, not adjusted: equations 4.1-4.6, tables 4.1 and 4.2, text."""

from __future__ import annotations

import math

import numpy as np

from fg_orient.adjustment.linear import conditioning
from fg_orient.model.cells import CellKey
from fg_orient.model.names import COMPONENTS, EOP_SETS, Role
from fg_orient.model.parameters import N_EOP, eop_codes
from fg_orient.simulate.point_sets import CHECK_COUNT
from fg_orient.studies.study import ILL_CONDITIONED
from fg_orient.studies.tables_twin import LEAST_SQUARES, Cells, component_label, labels
from fg_orient.studies.two_stage import TwoStage

#: Points of the SPOT-6 scene (T sect. 4.3.1).
SPOT6_POINTS = 99
#: Sets of Terlemezoğlu (2019); further ones are not in its tables.
PUBLISHED_SETS = tuple(number for number in EOP_SETS if number <= 20)
COUNTED_SETS = (1, *ILL_CONDITIONED)


def counts(run: TwoStage) -> Cells:
    """All counted cells, of a run with point set H-10."""
    return _equations(run) | _sets() | _text(run)


def rfm_unknowns(degree: int) -> int:
    """Coefficients of a rational function model: two numerators, two denominators with constant 1 (T 2.53)."""
    return 4 * math.comb(degree + 3, 3) - 2


def _equations(run: TwoStage) -> Cells:
    """Counts of observations and unknowns, from the systems themselves."""
    block = run.block
    control = block.points.where(Role.CONTROL)
    left = int(np.sum((block.observations.image == 0) & np.isin(block.observations.point, control)))
    out = {
        CellKey("eq4.1", stage="pre-adjustment", quantity="n_observations"): 2 * left,
        CellKey("eq4.2", stage="bundle", quantity="n_observations"): 2 * len(block.observations),
        CellKey("eq4.5", stage="rfm", quantity="n_observations"): 2 * SPOT6_POINTS,
    }
    for number in COUNTED_SETS:
        system = run.pre_adjust(0, number, LEAST_SQUARES).system
        out[CellKey("eq4.3", str(number), "pre-adjustment", quantity="n_unknowns")] = len(system)
        unknowns = len(block.images) * len(eop_codes(number)) + 3 * len(run.check_ids)
        out[CellKey("eq4.4", str(number), "bundle", quantity="n_unknowns")] = unknowns
    for degree in (1, 2, 3):
        out[CellKey("eq4.6", stage=f"rfm degree {degree}", quantity="n_unknowns")] = rfm_unknowns(degree)
    return {key: float(value) for key, value in out.items()}


def _sets() -> Cells:
    """Polynomial degree of each EOP, size of each EOP set, place of each member."""
    per_component = N_EOP // len(COMPONENTS)
    out: Cells = {
        CellKey("4.1", quantity="degree", parameter=component_label(c)): float(per_component - 1)
        for c in range(len(COMPONENTS))
    }
    for number in PUBLISHED_SETS:
        out[CellKey("4.2", str(number), quantity="n_unknowns")] = float(len(eop_codes(number)))
        for place, name in enumerate(labels(number), start=1):
            out[CellKey("4.2", str(number), quantity="order", parameter=name)] = float(place)
    return out


def _text(run: TwoStage) -> Cells:
    """Numbers of the text that the project counts or holds itself."""
    homogeneous = [name for name in CHECK_COUNT if name.startswith("H")]
    n_gcp, n_icp = len(run.control_ids), len(run.check_ids)
    values = {
        "n_points_total_spot5": n_gcp + n_icp, "h10_n_gcp": n_gcp, "h10_n_icp": n_icp,
        "n_point_distributions": len(CHECK_COUNT), "n_distributions_homogeneous": len(homogeneous),
        "n_distributions_grouped": len(CHECK_COUNT) - len(homogeneous), "n_eop_sets": len(PUBLISHED_SETS),
        "n_images_spot5": len(run.block.images), "rfm_coefficients_degree3": rfm_unknowns(3),
        "cond_norm_limit": conditioning.NORM_LIMIT, "cond_spectral_limit": conditioning.SPECTRAL_LIMIT,
        "cond_hadamard_limit": conditioning.HADAMARD_LIMIT,
    }  # fmt: skip
    return {CellKey("text", quantity=key): float(value) for key, value in values.items()}
