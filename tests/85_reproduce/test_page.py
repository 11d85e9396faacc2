"""In the page, the grid has every cell of a table once, and the scatter plot has its values."""

from __future__ import annotations

import math
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from fg_orient.model.names import CellKey
from fg_orient.report.chart import Axis, Chart
from fg_orient.report.svg import svg
from fg_orient.studies.published.tables import load
from fg_orient.studies.reproduce.folder import grid, l_curves, reproduce_to, scatter
from fg_orient.studies.reproduce.reproduction import Row, reproduce


def row(key: CellKey, published: float = 1.0, reproduced: float = 1.0, verdict: str = "equal") -> Row:
    return Row(key, published, reproduced, 0.0, 0.0, verdict, "", f"{published:g}", "m", "")


@pytest.mark.behaviour
@pytest.mark.parametrize("name", ["terlemezoglu2019", "topan2010"])
def test_grids_lose_no_cell(name: str) -> None:
    """Each published cell is in the grid of its table once, below its own solver or set."""
    printed = load(name)
    drawn = 0
    for table in printed.titles:
        rows = [row(c.key) for c in printed.cells if c.key.table == table]
        found = grid(rows)
        if found is None:
            assert len({r.key.method for r in rows} - {""}) < 2
            continue
        drawn += 1
        cells = [cell for _, line in found.rows for cell in line if cell is not None]
        assert sorted(map(id, cells)) == sorted(map(id, rows)), table
        for _, line in found.rows:
            for column, cell in zip(found.columns, line, strict=True):
                key = None if cell is None else cell.key
                own = None if key is None else key.eop_set if column.startswith("set ") else key.method
                if own:  # a cell without one is in the first column
                    assert own.replace("_", " ") == column.removeprefix("set ")
    assert drawn > 1 or name == "topan2010"


@pytest.mark.behaviour
def test_scatter_places_sizes_on_logarithmic_axes() -> None:
    keys = [CellKey("1", quantity=q) for q in "abcde"]
    rows = [
        row(keys[0], 1.0, -100.0, "differs"), row(keys[1], 1e-2, 1e-2), row(keys[2], 100.0, 1e2, "order"),
        row(keys[3], 0.0, 1.0), row(keys[4], 1.0, math.nan),
    ]  # fmt: skip
    chart = scatter(rows)
    assert chart is not None
    dots = {m.kind: (m.x.tolist(), m.y.tolist()) for m in chart.marks if m.shape == "dots"}
    assert dots == {  # neither zero nor a number that is not there; sizes: the sign does not count
        "dot differs": ([1.0], [100.0]), "dot equal": ([0.01], [0.01]), "dot order": ([100.0], [100.0]),
    }  # fmt: skip
    (left, bottom), (right, top) = chart.place([0.01, 100.0], [0.01, 100.0])
    assert (left, right) == pytest.approx((chart.left, chart.width - chart.right))
    assert (top, bottom) == pytest.approx((chart.top, chart.height - chart.bottom))
    assert chart.place(1.0, 100.0) == pytest.approx([(left + right) / 2.0, top])
    words = [e.text for e in ElementTree.fromstring(str(svg(chart))).iter("text")]
    assert words.count("1e−2") == words.count("1e2") == words.count("1e0") == 2 and "published" in words
    assert scatter(rows[3:]) is None


@pytest.mark.behaviour
def test_scatter_is_small_and_escaped(rng: np.random.Generator) -> None:
    values = 10.0 ** rng.uniform(-3.0, 3.0, (5_000, 2))
    text = str(svg(scatter([row(CellKey("<b>", quantity="&"), *pair.tolist()) for pair in values])))
    ElementTree.fromstring(text)
    assert "<b>" not in text and 100 < text.count("<title>") < 5_000


@pytest.mark.consistency
def test_kappas_of_the_tables_stand_on_their_l_curves(tmp_path: Path) -> None:
    found, _ = reproduce_to("terlemezoglu2019", tmp_path / "out", tables="4.25,4.27", n_seeds=1, claims=False)
    assert sorted(found.curves) == [5, 13, 15, 17, 19, 20]
    drawn = l_curves(found)
    kappas = {r.key: r for r in found.rows if r.key.quantity == "kappa"}
    for one in drawn:
        own = {k: r for k, r in kappas.items() if (k.eop_set, k.pre_adjustment_type) == (str(one["eop_set"]), "1")}
        by_rule = {rule["rule"]: rule["kappa"] for rule in one["rules"]}
        for key, row in own.items():  # the curve is that of the system whose kappa stands in the table
            assert by_rule[key.method.removeprefix("tikhonov_")] == row.reproduced
        printed = [rule for rule in one["rules"] if rule["chosen"]]
        assert sorted(rule["kappa"] for rule in printed) == sorted(row.published for row in own.values())
        labels = re.findall(r'class="mark-label"[^>]*>([^<]*)<', svg(one["drawing"]))
        marked = {int(number) for label in labels for number in label.split(", ")}
        assert marked == {rule["number"] for rule in one["rules"] if rule["residual_norm"] and rule["solution_norm"]}
        assert 'class="line-dot"' in svg(one["drawing"])
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    assert page.count('class="panel broad"') == 6 and 'href="#l-curves"' in page
    none = reproduce("terlemezoglu2019", tables="4.28", n_seeds=1, claims=False)
    assert none.curves == {} and l_curves(none) == []


@pytest.mark.behaviour
def test_a_long_number_at_the_end_of_an_axis_is_not_cut() -> None:
    """A long number at the end of an axis is inside the picture.

    40000 was drawn as 4000, because half of the text was outside.
    """
    chart = Chart("length", Axis("m", (0.0, 40000.0)), Axis("m", (0.0, 1.0)), width=300.0, height=200.0)
    ticks = {e.text: e for e in ElementTree.fromstring(str(svg(chart))).iter("text")}
    last = ticks["40000"]
    assert last.get("text-anchor") == "middle"
    assert float(last.get("x", "nan")) + 2.5 * 7.3 <= chart.width  # digits of 13 px are 7.3 px wide
