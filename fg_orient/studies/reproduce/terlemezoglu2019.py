"""Terlemezoğlu (2019), tables 4.1-4.55: what computes them and what is known about their misfits."""

from __future__ import annotations

from typing import Final

from fg_orient.studies import tables_spot5, tables_spot6
from fg_orient.studies.published.tables import PublishedCell
from fg_orient.studies.reproduce import spot6
from fg_orient.studies.reproduce.rules import ICP_LIMIT_M
from fg_orient.studies.reproduce.sources import Source


def explain(cell: PublishedCell, as_run: bool = False) -> str:
    """Say what is known about a cell that differs; "" if nothing is."""
    key = cell.key
    if key.table in {"eq4.5", "eq4.6"}:
        return "misprint of the source: its own tables use the reproduced count"
    if key.point_role == "icp" and cell.value > ICP_LIMIT_M:
        if as_run:
            return "without bundle rounding decides how far check points diverge"
        return "printed as if check points were intersected after step 2, without bundle (as run), where they diverge"
    if key.quantity == "dP" and "V" in key.parameter:
        return "velocities are printed larger by decades; not explained"
    if key.point_role == "gcp" and key.eop_set == "13" and key.method in {"moore_penrose_inverse", "tikhonov_od"}:
        if as_run:
            return "not explained: type 1 errs by some metres without bundle and by 3e4 m and more with it"
        return "the program ruins set 13 by the length of its across-track axis, which follows the unknowns (as run)"
    if key.eop_set == "15" and key.point_role == "gcp":
        if as_run:
            return "the size depends on the y-parallaxes of points that are not published"
        return "the program intersects control points with corrected attitudes from uncorrected positions (as run)"
    if key.point_role == "gcp":
        return "the size of dP is rounding noise, and with it on which side of the target a set falls"
    if key.quantity == "det":
        return "the determinant depends on the units of all unknowns and on the points"
    return ""


SOURCE: Final = Source(
    "terlemezoglu2019",
    "Terlemezoğlu (2019), regularisation of ill-conditioned systems in the orientation of satellite images",
    tables_spot5.compute,
    (
        "C1",
        "C2",
        "C4",
        "C5",
        "C6",
        "C8",
        "C9",
        "C10",
        "C11",
        "C12",
        "C13",
        "C14",
        "C15",
        "C16",
        "C17",
        "C18",
        "C19",
        "C20",
        "C21",
        "C22",
    ),
    explain,
    spot6.verdicts,
    tables_spot6.TABLES,
    curves=tables_spot5.tikhonov_curves,
)
