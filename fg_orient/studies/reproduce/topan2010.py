"""Topan & Maktav (2010), tables 1 and 2: what computes them and what is known about their misfits."""

from __future__ import annotations

from typing import Final

from fg_orient.studies import tables_topan
from fg_orient.studies.published.tables import PublishedCell
from fg_orient.studies.reproduce.sources import Source


def explain(cell: PublishedCell, as_run: bool = False) -> str:
    """Say what is known about a cell that differs; "" if nothing is."""
    key = cell.key
    if key.quantity == "n_gcp_needed_unmodelled_printed":
        return "misprint of the source: 108000 / 2"
    if key.table != "2" or key.point_role != "gcp":
        return ""
    if key.eop_set in {"15", "16"}:
        if as_run:
            return "the size depends on the y-parallaxes of points that are not published"
        return "the program intersects control points with corrected attitudes from uncorrected positions (as run)"
    if key.eop_set in {"14", "18"}:
        if as_run:
            return "a weak direction: its size depends on the noise and on the radial velocity of the real scenes"
        return "in the program the length of the across-track axis follows the velocity (as run)"
    return "the size of dP is rounding noise, and with it on which side of the target a set falls"


SOURCE: Final = Source(
    "topan2010",
    "Topan & Maktav (2010), geometric accuracy of stereo SPOT-5 HRG level 1A images",
    tables_topan.compute,
    ("C1", "C2", "C3", "C4", "C5", "C6", "C7", "C11"),
    explain,
)
