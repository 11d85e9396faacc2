"""Records of ``accuracy.check``: whether predictions hold, and whether the differences have a mean of their own."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from fg_orient.model.errors import NoSolutionError

if TYPE_CHECKING:
    from fg_orient.orientation.solution import Solution


def prediction_records(solution: Solution) -> dict[str, Any]:
    """Keys ``prediction`` (null where it cannot be tested), ``prediction_withheld`` (why) and ``bias``.

    Parameters
    ----------
    solution : Solution
    """
    from fg_orient.quality.prediction_test import bias_test

    bias = bias_test(solution.accuracy.check) or None
    try:
        return {"prediction": solution.prediction_test().as_dict(), "prediction_withheld": None, "bias": bias}
    except NoSolutionError as error:
        return {"prediction": None, "prediction_withheld": str(error), "bias": bias}
