"""The study of cost and size is tested on invented values and on small blocks."""

from __future__ import annotations

import json
import math
from importlib import util
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.adjustment.problem import compile_problem
from fg_orient.studies.comparison import scale as study_of_sizes
from fg_orient.studies.comparison.scale import block_of, crossings, exponent, exponents, scale, sizes_of
from fg_orient.studies.comparison.scale_page import page
from fg_orient.studies.comparison.work import Sparsity
from tests.support.command import Run

SIZES = (10, 20, 40, 80)
FILES = {
    "scale.csv", "orderings.csv", "exponents.csv", "result.json", "scale.md", "captions.md",
    *(f"{name}.{kind}" for name in ("time", "memory", "orderings", "jacobian", "matrices", "trees")
      for kind in ("svg", "pdf")),
}  # fmt: skip


def made_up(engine: str, backend: str, power: float, at_one: float) -> list[dict[str, Any]]:
    given = {"engine": engine, "backend": backend, "failure": "", "factor_elements": math.nan, "peak_bytes": math.nan}
    return [
        given | {"image_points": n, "unknowns": 3 * n, "processor_s": at_one * n**power}
        for n in (10, 100, 1000, 10_000)
    ]


@pytest.mark.truth
def test_exponent_and_crossing_of_power_laws() -> None:
    """The exponents and the crossing of exact power laws are found: 1e-6 n^3 and 1e-2 n meet at n = 100.

    The interval of exact values is zero.
    """
    rows = made_up("full", "dense", 3.0, 1e-6) + made_up("graph", "graph", 1.0, 1e-2)
    found = {e["engine"]: e for e in exponents(rows)}
    for engine, power in (("full", 3.0), ("graph", 1.0)):
        assert found[engine]["exponent"] == pytest.approx(power, abs=1e-9)
        assert found[engine]["unknowns_exponent"] == pytest.approx(power, abs=1e-9)
        assert found[engine]["half_interval"] < 1e-6
    (crossing,) = crossings(rows)
    assert crossing["image_points"] == pytest.approx(100.0) and crossing["always"] == ""
    cheap, dear = made_up("cheap", "graph", 1.0, 1e-9), made_up("dear", "graph", 3.0, 1.0)
    assert [c["always"] for c in crossings(rows[:4] + cheap + dear)] == ["sparse", "dense"]
    assert exponent([(10, 1.0), (100, 1.0), (1000, 1.01), (10_000, 1.02)]) == {}  # overhead alone


@pytest.mark.oracle
def test_interval_of_the_exponent_covers_it() -> None:
    """The 95 % interval of the exponent contains the true one in 370 to 392 of 400 draws with 10 % noise."""
    rng, n = np.random.default_rng(2), 10.0 ** np.arange(1, 8)
    held = 0
    for _ in range(400):
        e = exponent([(x, x**1.5 * math.exp(0.1 * rng.standard_normal())) for x in n.tolist()])
        held += abs(e["exponent"] - 1.5) <= e["half_interval"]
    assert 370 <= held <= 392


@pytest.mark.behaviour
def test_sizes() -> None:
    assert sizes_of("1e3, 10,10") == (10, 1000) and sizes_of([50, 20]) == (20, 50)
    for wrong in ("9", "1.5", "1e9", "many", ""):
        with pytest.raises(fg.InputError) as caught:
            sizes_of(wrong)
        assert caught.value.problems[0].code in ("compare.size", "compare.nothing")
    with pytest.raises(fg.InputError) as caught:
        scale([10], time_limit_s=0.0)
    assert [p.code for p in caught.value.problems] == ["compare.time_limit"]


@pytest.mark.behaviour
@pytest.mark.parametrize("size", [10, 300, 5000])
def test_blocks_have_about_this_size(size: int) -> None:
    assert len(block_of(size).observations) == pytest.approx(size, rel=0.1)


@pytest.mark.oracle
def test_elements_and_operations_of_orders() -> None:
    """Elements and operations of each order equal a block elimination of a boolean matrix.

    Images are first or points are first.
    """
    block = block_of(40)
    problem = compile_problem(block)
    rows = {r["ordering"]: r for r in study_of_sizes._orderings(problem)}
    points, images = int(problem.active.sum()), problem.n_images
    place = np.cumsum(problem.active) - 1
    linked = np.zeros((images + points,) * 2, bool)
    o = problem.observations
    for i, j in zip(o.image.tolist(), o.point.tolist(), strict=True):
        linked[i, images + place[j]] = linked[images + place[j], i] = True
    sizes = np.array([*np.diff(problem.first), *[3] * points])
    natural = np.arange(images + points)
    for name, order in (("natural", natural), ("points first", np.roll(natural, -images))):
        pattern, s = linked[np.ix_(order, order)].copy(), sizes[order]
        elements = operations = 0.0
        for k in range(len(s)):
            later = np.flatnonzero(pattern[k, k + 1 :]) + k + 1
            d = float(s[later].sum())
            elements += s[k] * (s[k] + 1) / 2 + s[k] * d
            operations += s[k] ** 3 / 3 + s[k] ** 2 * d + s[k] * d**2
            pattern[np.ix_(later, later)] = True
        assert rows[name]["nonzeros_factor"] == elements
        assert rows[name]["operations"] == pytest.approx(operations, rel=1e-12)
        assert rows[name]["processor_s"] > 0.0
    normal = Sparsity(problem).normal
    assert all(r["nonzeros_factor"] - r["fill"] == normal for r in rows.values())


@pytest.mark.consistency
def test_finished_sizes_are_kept_and_engines_agree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = scale([10, 20], folder=tmp_path)
    monkeypatch.setattr(study_of_sizes, "block_of", None)  # not made again
    again = scale([10, 20], folder=tmp_path)
    assert json.dumps(again["rows"]) == json.dumps(first["rows"])
    tried = [r for r in first["rows"] if not r["left_out"]]
    assert len(tried) == 2 * 9 and not any(r["failure"] for r in tried)
    assert max(r["difference_sigmas"] for r in tried) < 1e-9


@pytest.mark.behaviour
def test_what_is_too_large_is_a_row_with_the_reason() -> None:
    rows = scale([200], time_limit_s=0.1)["rows"]
    left = {r["engine"]: r["failure"] for r in rows if r["left_out"]}
    assert "more than 0.1 s" in left["dense · QR"]
    assert not any(r["failure"] for r in rows if r["backend"] == "graph")
    rows = scale([200], memory_limit_gb=0.003)["rows"]
    assert any("are allowed" in r["failure"] for r in rows if r["backend"] == "dense")


@pytest.mark.slow
@pytest.mark.behaviour
def test_folder_of_the_command(run: Run, tmp_path: Path) -> None:
    out, words = tmp_path / "scale", ("--sizes", ",".join(map(str, SIZES)), "--time-limit", "5")
    ended = run("compare", "--scale", *words, "--out", out, "--json")
    assert ended.code == 0, ended.stderr
    assert {p.name for p in out.iterdir()} == FILES and not list(tmp_path.glob(".*"))
    record = json.loads((out / "result.json").read_text("utf-8"))
    assert record == ended.json | {"out": "scale"}
    text = (out / "scale.md").read_text("utf-8")
    assert text == page(record)
    for row in record["rows"]:
        if not row["failure"]:
            assert f"{row['processor_s']:.3g}" in text
    assert record["processor"] in text and record["date"] in text
    shown = run("compare", "--scale", *words, "--out", out, "--overwrite")
    assert shown.code == 0 and "scale.md" in shown.stdout and "dense" in shown.stdout


@pytest.mark.behaviour
def test_refusals(run: Run, project: Path, tmp_path: Path) -> None:
    for words, place in (
        (("compare", project, "--scale"), "PROJECT.toml"), (("compare", "--scale", "--eop-sets", "1"), "--eop-sets"),
        (("compare",), "PROJECT.toml"), (("compare", project, "--sizes", "10"), "--sizes"),
        (("compare", "--scale", "--sizes", "3"), "--sizes"),
    ):  # fmt: skip
        ended = run(*words, "--out", tmp_path / "out")
        assert ended.code == 2 and len(ended.stderr.splitlines()) == 1, ended.stderr
        assert place in ended.stderr


@pytest.mark.repository
def test_page_of_the_documentation_is_that_of_its_record(repository: Path) -> None:
    spec = util.spec_from_file_location("docs_scale", repository / "docs" / "scale.py")
    assert spec is not None and spec.loader is not None
    module = util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert (repository / "docs" / "scale.md").read_text("utf-8") == module.text()
