"""In the null model printed values are exchanged between cells of the same role."""

from __future__ import annotations

from functools import partial

import numpy as np
import numpy.typing as npt
import pytest

from fg_orient.model.names import CellKey
from fg_orient.studies.published.tables import PublishedCell, PublishedTables
from fg_orient.studies.reproduce.reproduction import SOURCES, baseline, pair, roles
from fg_orient.studies.reproduce.verdict import Recomputed, assess_runs, assess_value

Printed = dict[str, PublishedTables]
Computed = dict[str, dict[CellKey, npt.NDArray[np.float64]]]


def cell(key: CellKey, text: str) -> PublishedCell:
    """Return the cell with a printed number."""
    return PublishedCell(key, float(text), text, text)


def by_set(texts: list[str], quantity: str = "rmse_x", role: str = "icp") -> list[PublishedCell]:
    """Return the cells of one role that differ by EOP set alone."""
    return [
        cell(CellKey("2", str(number), "bundle", point_role=role, quantity=quantity), text)
        for number, text in enumerate(texts, start=1)
    ]


@pytest.mark.behaviour
def test_a_comparison_that_knows_the_role_alone_gains_nothing() -> None:
    """If every cell is compared with the same runs, the null model has the counts of the verdicts."""
    cells = by_set(["3.0", "4.0", "80.0", "5.5", "9.0", "700.0"])
    runs = np.array([4.0, 5.0, 6.0])
    null = baseline(cells, {c.key: partial(assess_runs, runs=runs) for c in cells})
    kinds = [assess_runs(c, runs).kind for c in cells]
    assert {kind: n for kind, n in null.verdicts["2"].items() if n} == {
        kind: kinds.count(kind) for kind in dict.fromkeys(kinds)
    }
    assert kinds.count("order") == 4 and kinds.count("differs") == 2


@pytest.mark.behaviour
def test_a_comparison_that_knows_the_cells_gains_nearly_all() -> None:
    cells = by_set([f"{3.0 * 100.0**k}" for k in range(8)])
    null = baseline(cells, {c.key: partial(assess_runs, runs=np.array([1.1 * c.value])) for c in cells}, 200)
    assert null.verdicts["2"]["order"] == pytest.approx(1.0, abs=0.3)  # a permutation keeps one value in its place
    assert max(null.chance.values()) < 0.25


@pytest.mark.behaviour
def test_what_nothing_can_be_exchanged_with_is_left_out() -> None:
    alone = [cell(CellKey("text", quantity=q), "12") for q in ("n_gcp", "n_icp")]
    words = PublishedCell(CellKey("text", "1", quantity="n_gcp"), float("nan"), "", "two")
    null = baseline([*alone, words], {c.key: partial(assess_runs, runs=np.array([12.0])) for c in [*alone, words]})
    assert null.chance == {} and not any(null.verdicts["text"].values())
    assert roles([cell(CellKey("1", parameter=f"ring {k}", quantity="d"), "1.0") for k in range(3)]) == [[0, 1, 2]]
    assert roles([cell(CellKey("1", "1", parameter=p, quantity="dP"), "1.0") for p in ("X0", "Y0")]) == []


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("value", "half", "within", "kind"),
    [
        (0.514, 0.2, "sigma", "rounding"), (0.52, 0.2, "sigma", "sigma"), (0.52, 0.2, "spread", "spread"),
        (0.514, 0.2, "fitted", "fitted"), (0.52, 0.001, "sigma", "differs"), (0.514, np.nan, "spread", "equal"),
        (0.519, np.nan, "spread", "unit"), (0.531, np.nan, "spread", "differs"),
    ],
)  # fmt: skip
def test_verdicts_beside_a_stated_spread(value: float, half: float, within: str, kind: str) -> None:
    one = cell(CellKey("1", quantity="x"), "0.51")
    assert assess_value(one, Recomputed.around(value, half), "", within=within).kind == kind  # type: ignore[arg-type]


@pytest.mark.truth
def test_check_points_of_topan_table_2_say_nothing_on_their_cells(printed: Printed, computed: Computed) -> None:
    """Check points of Topan's table 2 agree no more often than exchanged ones, and count as uninformative.

    The cells have the size of their role, as any exchange of them has.
    """
    rows, null = pair(printed["topan2010"], computed["topan2010"], SOURCES["topan2010"], ("2",))
    check = [row for row in rows if row.key.point_role == "icp"]
    agree = [null.chance[row.key] for row in check if row.verdict == "order"]
    assert len(check) == 171 and len(agree) > 150
    assert len(agree) <= sum(null.chance[row.key] for row in check) + 1.0
    assert not any(row.informs for row in rows)
