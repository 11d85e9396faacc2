"""The address of a table cell: what a published and a reproduced value have in common."""

from __future__ import annotations

from typing import NamedTuple


class CellKey(NamedTuple):
    """Position of a number in the published tables; fields that do not apply are empty.

    The values are those of the tables under ``fg_orient/studies/published``: for instance
    ``CellKey("4.28", "5", "bundle", "1", "gcp", "rmse_x", "pivot_inverse")``.
    """

    table: str
    eop_set: str = ""
    stage: str = ""
    pre_adjustment_type: str = ""
    point_role: str = ""
    quantity: str = ""
    method: str = ""
    parameter: str = ""
    point_set: str = ""

    def __str__(self) -> str:
        words = (
            self.point_set, self.eop_set and f"set {self.eop_set}", self.stage,
            self.pre_adjustment_type and f"type {self.pre_adjustment_type}", self.point_role, self.quantity,
            self.parameter, self.method,
        )  # fmt: skip
        return ", ".join(filter(None, words))
