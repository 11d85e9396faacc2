"""An adjustment by a Tikhonov solver has its curve in the record, on the page and as a figure."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest

import fg_orient as fg
from fg_orient.adjustment.dense import assemble
from fg_orient.report import figures, paper
from fg_orient.report.chart import log_ticks
from fg_orient.report.html import render
from fg_orient.report.plots import l_curve, ranked
from fg_orient.result.record import Result, read_result
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block
from tests.support.command import Run


@pytest.fixture(scope="module")
def damped(project: Path, tmp_path_factory: pytest.TempPathFactory, run: Run) -> Path:
    """Allow only two steps, because with this kappa the iteration creeps."""
    out = tmp_path_factory.mktemp("damped") / "result"
    run("adjust", project, "--out", out, "--backend", "dense", "--solver", "tikhonov_gcv", "--max-iterations", 2)
    return out


@pytest.fixture(scope="module")
def folder(damped: Path) -> Result:
    return read_result(damped)


@pytest.fixture(scope="module")
def section(folder: Result) -> dict[str, Any]:
    found: dict[str, Any] = folder.record["regularisation"]
    return found


@pytest.mark.oracle
def test_curve_is_that_of_the_first_step(folder: Result, section: dict[str, Any]) -> None:
    """The recorded L-curve is that of the first step, with the kappas of all iterations, from the block's rows."""
    log = folder.iterations
    assert section["kappa"] == log[0]["kappa"] and section["rule"] == "gcv"
    assert section["steps"] == [{"iteration": i["iteration"], "kappa": i["kappa"]} for i in log]
    problem = fg.adjust(zonguldak_block(ZonguldakOptions())[0], max_iterations=1).problem
    residual, design = assemble(problem, problem.start)
    values, k = section["curve"], 60
    kappa = values["kappa"][k]
    x = np.linalg.solve(design.T @ design + kappa * np.eye(design.shape[1]), -design.T @ residual)
    assert values["solution_norm"][k] == pytest.approx(float(np.linalg.norm(x)), rel=1e-6)
    assert values["residual_norm"][k] == pytest.approx(float(np.linalg.norm(design @ x + residual)), rel=1e-6)
    chosen = next(c for c in section["rules"] if c["rule"] == "gcv")
    assert chosen["residual_norm"] ** 2 == pytest.approx(log[0]["chi2"] - log[0]["predicted"], rel=1e-9)


@pytest.mark.behaviour
def test_there_is_none_without_such_a_solver(adjusted: Path) -> None:
    record = json.loads((adjusted / "result.json").read_text("utf-8"))
    assert record["regularisation"] is None
    text = (adjusted / "report.html").read_text("utf-8")
    assert 'id="regularisation"' not in text and "κ" not in text
    assert l_curve(None) is None


@pytest.mark.behaviour
@pytest.mark.parametrize("choice", [{"loss": "huber"}, {"optimizer": "dogleg"}, {"datum": "inner"}])
def test_other_ways_through_the_adjustment_have_one_too(choice: dict[str, Any]) -> None:
    """With a loss, dogleg or inner constraints the result has an L-curve, with another kappa except for dogleg.

    A loss weights the rows, dogleg blends the steps, inner constraints leave out priors.
    """
    block = zonguldak_block(ZonguldakOptions())[0]
    given = {"backend": "dense", "solver": "tikhonov_gcv", "max_iterations": 2}
    found = fg.adjust(block, **given, **choice).regularisation
    assert found is not None and found["kappa"] is not None and np.isfinite(found["curve"]["solution_norm"]).all()
    plain = fg.adjust(block, **given).regularisation
    assert plain is not None and (found["kappa"] == plain["kappa"]) == (choice == {"optimizer": "dogleg"})


@pytest.mark.behaviour
def test_page_draws_the_curve_and_lists_every_rule(damped: Path, section: dict[str, Any]) -> None:
    text = (damped / "report.html").read_text("utf-8")
    part = text[text.index('<section id="regularisation"') :]
    part = part[: part.index("</section>")]
    assert all(rule["label"] in part for rule in section["rules"]) and part.count("(chosen)") == 1
    drawing = part[part.index("<svg") : part.index("</svg>")]
    xs, ys = np.array(re.findall(r"([0-9.]+) ([0-9.]+)L", drawing), float).T
    assert len(xs) == len(section["curve"]["kappa"]) - 1
    assert np.all(np.diff(xs) >= 0.0) and np.all(np.diff(ys) >= 0.0)  # down the page, to the right
    numbers = sorted(int(n) for label in re.findall(r'mark-label"[^>]*>([^<]*)<', drawing) for n in label.split(", "))
    assert numbers == [c["number"] for c in ranked(section) if not c["failure"]]
    (chosen,) = re.findall(r'class="line-dot" d="([^"]*)"', drawing)
    assert chosen.count("M") == 1
    assert re.search(r"<th[^>]*>κ</th><th[^>]*>taken", text)


@pytest.mark.behaviour
def test_hostile_words_in_the_section_are_escaped(damped: Path) -> None:
    result = read_result(damped)
    kept = result.record["regularisation"]
    rules = [{**rule, "label": "<img src=x>", "notes": ["<script>"]} for rule in kept["rules"]]
    record = {**result.record, "regularisation": {**kept, "label": "<b>", "rules": rules}}
    text = render(replace(result, record=record))
    assert "<img src=x>" not in text and "&lt;img src=x&gt;" in text and "[&#39;" not in text


@pytest.mark.consistency
def test_figure_holds_the_curve_and_the_caption_the_kappas(folder: Result, section: dict[str, Any]) -> None:
    chart = l_curve(section)
    assert chart is not None
    with matplotlib.rc_context(paper.STYLE):
        figure = paper.figure_of([chart])
        (axes,) = figure.axes
        assert np.array_equal(axes.lines[0].get_xdata(), section["curve"]["residual_norm"])
        assert np.array_equal(axes.lines[0].get_ydata(), section["curve"]["solution_norm"])
        marks = [c.get_offsets() for c in axes.collections]
        assert [len(m) for m in marks] == [sum(not c["failure"] for c in section["rules"]) - 1, 1]
        shown = ", ".join(text.get_text() for text in axes.texts).split(", ")
        assert sorted(map(int, shown)) == [c["number"] for c in ranked(section) if not c["failure"]]
        assert paper.file_of(figure, "svg") == paper.file_of(figure, "svg")
    told = figures.captions(folder, [("l_curve", "l_curve", [])])
    assert f"Generalised cross-validation: κ = {section['kappa']:.3g}" in told


@pytest.mark.behaviour
def test_ticks_of_few_and_many_decades() -> None:
    assert np.allclose(log_ticks(10.0**1.2, 10.0**2.1), [20, 50, 100])
    assert np.allclose(np.log10(log_ticks(10.0**-3.2, 10.0**2.1)), [-3, -2, -1, 0, 1, 2])
    assert len(log_ticks(1e-16, 1e14)) <= 8
    assert np.allclose(log_ticks(10.0**1.826, 10.0**1.833), [67.0, 67.5, 68.0])
