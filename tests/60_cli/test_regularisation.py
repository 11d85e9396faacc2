"""With a regularisation on the command line, the first line, the record and the report name it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

SET_20 = ("--eop-set", 20, "--no-priors")


@pytest.mark.behaviour
def test_first_line_record_and_report_say_that_the_estimate_is_regularised(run: Any, twin: Path) -> None:
    words = (*SET_20, "--regularisation", "tikhonov", "--kappa", 0.5)
    ended = run("adjust", twin, *words, "--overwrite")
    assert ended.code == 0
    assert "regularised (tikhonov, kappa 0.5)" in next(line for line in ended.stdout.splitlines() if "after" in line)
    assert "note: the 54 image unknowns are regularised (tikhonov, kappa 0.5): the estimate is biased" in ended.stdout
    record = run("adjust", twin, *words, "--overwrite", "--json").json
    assert (record["regularisation"]["kappa"], len(record["regularisation"]["unknowns"])) == (0.5, 54)
    page = (twin.parent / record["out"] / "report.html").read_text()
    assert "Converged, regularised (tikhonov, kappa 0.5)" in page
    assert "Image unknowns, in prior standard deviations" in page and "determined by" in page


@pytest.mark.behaviour
def test_ambiguous_rank_is_exit_4(run: Any, twin: Path) -> None:
    ended = run(
        "adjust", twin, *SET_20, "--regularisation", "minimum_norm", "--rank-cut", 1e-4, "--overwrite", "--quiet"
    )
    assert ended.code == 4
    (line,) = ended.stderr.splitlines()
    assert line.startswith(
        "not trustworthy, regularised (minimum norm): the rank 25 of the 54 image unknowns is ambiguous"
    )


@pytest.mark.behaviour
def test_options_of_a_project_file(run: Any, twin: Path) -> None:
    text = twin.read_text()
    for name, old, new in (("regularisation", "none", "truncated"), ("kappa_rule", "bayes", "gcv")):
        assert f'{name} = "{old}"' in text
        text = text.replace(f'{name} = "{old}"', f'{name} = "{new}"')
    twin.write_text(text)
    record = run("adjust", twin, *SET_20, "--overwrite", "--json").json
    assert (record["regularisation"]["label"], record["regularisation"]["rule"]) == ("truncated", "gcv")
