"""Warnings are codes with data: one record each, texts in the catalogue only, options without flags."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from fg_orient.cli.output import flag, tell_findings
from fg_orient.closerange.report_verdict import problems
from fg_orient.model.errors import Finding, as_record, finding, findings_of, judged, read
from tests.support.syntax import nodes

FLAG = re.compile(r"(?<![\w-])--[a-z][a-z-]+")
#: Flags of other programs: pip, and bundle_adjust of the Ames Stereo Pipeline.
OF_OTHERS = {
    "fg_orient/model/installation.py", "fg_orient/model/messages/program.py",
    "fg_orient/formats/exchange/asp_gcp.py",
}  # fmt: skip
#: The record, and the modules that make sentences for people from results: reports and the command line.
SHOWING = ("fg_orient/cli/", "fg_orient/model/messages/", "fg_orient/report/", "fg_orient/closerange/report/")


def library(repository: Path) -> Iterator[tuple[str, list[ast.AST]]]:
    """Yield the name and nodes of every module but those of the command line."""
    for path in sorted((*(repository / "fg_orient").rglob("*.py"), *(repository / "factors").rglob("*.py"))):
        name = path.relative_to(repository).as_posix()
        if not name.startswith("fg_orient/cli/"):
            yield name, nodes(path)


def texts(tree: ast.AST) -> list[str]:
    """Return the string literals below a node."""
    return [n.value for n in ast.walk(tree) if isinstance(n, ast.Constant) and isinstance(n.value, str)]


@pytest.mark.repository
def test_no_module_outside_the_command_line_names_a_flag(repository: Path) -> None:
    found = [
        (name, node.lineno, FLAG.findall(node.value))
        for name, own in library(repository)
        for node in own
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and FLAG.search(node.value)
    ]
    assert {name for name, *_ in found if name in OF_OTHERS} == OF_OTHERS
    assert [place for place in found if place[0] not in OF_OTHERS] == []


@pytest.mark.repository
def test_only_the_record_writes_and_reads_warnings(repository: Path) -> None:
    """Only ``model/errors.py`` contains the keys ``warnings`` and ``findings`` of a result."""
    named = {
        name
        for name, own in library(repository)
        for node in own
        if isinstance(node, ast.Constant) and node.value in ("warnings", "findings")
    }
    assert named == {"fg_orient/model/errors.py"}


@pytest.mark.repository
def test_no_sentence_is_given_as_a_warning_or_as_its_data(repository: Path) -> None:
    """No call outside the catalogue passes a text of four words or more as a warning or as data of a finding."""
    given = []
    for name, own in library(repository):
        if name.startswith(SHOWING):
            continue
        for node in own:
            if not isinstance(node, ast.Call):
                continue
            called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            for keyword in node.keywords:
                told = keyword.arg in ("warnings", "findings", "unavailable") or (
                    called == "finding" and keyword.arg not in ("place", "value", "file")
                )
                if told and any(len(text.split()) > 3 for text in texts(keyword.value)):
                    given.append((name, node.lineno, keyword.arg))
    assert given == []


def planted(**data: object) -> Finding:
    """Return a warning whose code, severity, sentence and remedy are stated where it is raised."""
    return finding(
        "outside.planted (warning): image {image} is upside down + , like {others:2} "
        "-> turn it with <turn_by> {angle:g}",
        **data,
    )


@pytest.mark.behaviour
def test_a_warning_from_outside_is_one_place(capsys: pytest.CaptureFixture[str]) -> None:
    found = planted(image="left", others=["a", "b", "c"], angle=180.0)
    assert (found.code, found.severity) == ("outside.planted", "warning")
    told = "image left is upside down, like a, b ...; turn it with {} 180"
    assert (str(found), found.text(flag)) == (told.format("option turn_by"), told.format("--turn-by"))
    alone = planted(image="left", others=[], angle=90.0)
    assert str(alone) == "image left is upside down; turn it with option turn_by 90"

    record = json.loads(json.dumps(as_record([found])))
    assert record["warnings"] == [str(found)]
    assert record["findings"][0]["data"] == {"image": "left", "others": ["a", "b", "c"], "angle": 180.0}
    assert findings_of(record) == (found,)
    assert problems(record | {"status": "good"}) == [str(found)]
    tell_findings(record)
    assert capsys.readouterr().err == f"warning: {found.text(flag)}\n"


@pytest.mark.behaviour
def test_doubts_decide_on_the_status() -> None:
    alone = planted(image="left", others=[], angle=90.0)
    assert judged([alone])["status"] == "good"
    assert judged([alone, finding("outside.doubt (doubt): {n} images are missing", n=2)])["status"] == "not_trustworthy"


@pytest.mark.behaviour
def test_a_code_has_one_entry() -> None:
    one = finding("outside.once (note): said once")
    assert finding("outside.once") == finding("outside.once (note): said once") == one
    with pytest.raises(ValueError, match=r"two entries of outside\.once"):
        finding("outside.once (note): said otherwise")


@pytest.mark.behaviour
def test_results_of_earlier_and_later_versions_are_read() -> None:
    """A record keeps its sentences if it has no code, if its code is unknown or if its data do not fit the code."""
    first, second = findings_of({"warnings": ["few points", "no fit"], "reason": "no fit"})
    assert [(str(one), one.severity) for one in (first, second)] == [("few points", "warning"), ("no fit", "doubt")]
    assert findings_of({}) == ()
    later: dict[str, Any] = {"code": "later.code", "severity": "note", "message": "said then", "remedy": "do so"}
    assert (str(read(later)), read(later).severity) == ("said then; do so", "note")
    assert str(read(later | {"code": "solution.few_check", "data": {"n": 1}})) == "said then; do so"


@pytest.mark.behaviour
def test_a_finding_shows_where_what_and_the_remedy_on_one_line() -> None:
    found = replace(finding("solution.no_check"), file="a.csv", place="line\n3", value="7")
    told = "a.csv, line 3: no check points: the accuracy is not verified independently (found 7)"
    assert str(found) == told and hash(found) == hash(replace(found))
    assert found.as_dict()["severity"] == "warning"


@pytest.mark.behaviour
def test_data_are_plain_and_lists_are_short() -> None:
    found = finding("solution.outside_validity", image=Path("left"), n=80, points=tuple(map(str, range(80))))
    assert found.data == {"image": "left", "n": 80, "points": [str(k) for k in range(50)]}
    assert str(found).startswith("80 points lie outside") and str(found).endswith(" 7, 8, 9 ...")


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("n", "text"),
    [(1, "1 check point is not used for the accuracy"), (12, "12 check points are not used for the accuracy")],
)
def test_noun_and_verb_agree_with_their_number(n: int, text: str) -> None:
    assert finding("search.check_points", n=n, points=["7"]).message.startswith(text)


@pytest.mark.behaviour
def test_names_of_the_user_stay_as_they_are() -> None:
    assert finding("search.check_points", n=2, points=["1 tree(s) are"]).message.endswith(": 1 tree(s) are")
