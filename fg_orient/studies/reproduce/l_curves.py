"""L-curves for the page of a reproduction: the kappas of its tables as places on the curve of each EOP set."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any, Final

from fg_orient.report.plots import l_curve, ranked
from fg_orient.result.plain import plain
from fg_orient.studies.reproduce.reproduction import Reproduction

#: Name of a printed kappa among the rules of a drawing.
PRINTED: Final = "printed"
#: The bundle is solved in the units of the publication, not in standard deviations.
AXES: Final = ("norm of the residuals |Ax − l|", "norm of the solution |x|, units of the publication")


def l_curves(found: Reproduction) -> list[dict[str, Any]]:
    """Drawing and kappas of each EOP set.

    Parameters
    ----------
    found : Reproduction

    Returns
    -------
    list of dict
        ``eop_set``, ``drawing``, ``rules`` in the order of their kappas; empty without tables of kappas.
    """
    return [_drawn(found, number) for number in found.curves]


def _drawn(found: Reproduction, number: int) -> dict[str, Any]:
    curve = found.curves[number]
    rules = [asdict(choice) | {"table": ""} for choice in curve.choices]
    labels = {f"tikhonov_{choice.rule}": choice.label for choice in curve.choices}
    for row in found.rows:
        key = found.keys[row.table, row.cell]
        if (key.quantity, key.eop_set, key.pre_adjustment_type) != ("kappa", str(number), "1"):
            continue
        residual, solution = curve.place(row.published)
        rules.append({
            "rule": PRINTED, "label": f"{labels.get(key.method, key.method)}, printed", "kappa": row.published,
            "residual_norm": residual, "solution_norm": solution, "notes": (), "failure": "", "table": row.table,
        })  # fmt: skip
    section = plain({"rule": PRINTED, "rules": rules, "curve": asdict(curve)})
    return {"eop_set": number, "drawing": l_curve(section, AXES), "rules": ranked(section)}
