"""The message catalogue agrees with the sources: no code is unknown or unused, and every field is given."""

from __future__ import annotations

import ast
import functools
import inspect
import re
import string
from importlib import import_module
from pathlib import Path

import pytest

from fg_orient.model.errors import FgOrientError, InputError, finding
from fg_orient.model.messages import CATALOGUE, MODULES
from fg_orient.model.messages.entry import Entry, words
from tests.support.syntax import nodes

ALWAYS = {"file", "place", "value", "option"}
FORMAT = string.Formatter()
OPTION = re.compile(r"<([a-z_]+)>")
FILE_SUFFIXES = {"csv", "toml", "json", "jsonl", "html", "npz", "txt", "py", "xml", "tif"}
#: An entry that is defined where it is raised.
INLINE = re.compile(r"([a-z0-9_]+\.[a-z0-9_]+) \((?:note|warning|doubt|failure)\): .")
CODE = re.compile(r"^[a-z0-9_]+\.[a-z0-9_]+$|^internal$")


@functools.cache
def sources(repository: Path) -> dict[str, list[ast.AST]]:
    """Return all nodes of each module of fg_orient by the module's name, but not those of the catalogue."""
    return {
        path.relative_to(repository).as_posix(): nodes(path)
        for path in sorted((repository / "fg_orient").rglob("*.py"))
        if path.parent.name != "messages" or path.name == "finding.py"
    }


def literal_codes(expression: ast.expr) -> list[str]:
    """Return the codes an expression can give: a literal, or the branches of a conditional expression."""
    if isinstance(expression, ast.Constant) and isinstance(expression.value, str):
        whole = INLINE.match(expression.value)
        return [whole[1] if whole else expression.value]
    if isinstance(expression, ast.IfExp):
        return literal_codes(expression.body) + literal_codes(expression.orelse)
    return []


@functools.cache
def entries(repository: Path) -> dict[str, Entry]:
    """Return the entries of the catalogue's tables and the entries defined where they are raised.

    Entries of other tests are not included.
    """
    codes = {code for name in MODULES for code in import_module(f"fg_orient.model.messages.{name}").WORDS}
    for node in (node for own in sources(repository).values() for node in own):
        text = node.value if isinstance(node, ast.Constant) else ""
        if isinstance(text, str) and INLINE.match(text):
            codes.add(finding(text).code)
    return {code: CATALOGUE[code] for code in codes}


@functools.cache
def calls(repository: Path) -> list[tuple[str, str, set[str] | None]]:
    """Return place, code and keywords of each ``finding("code", ...)`` and ``SomeError.of("code", ...)``.

    Keywords are None if a call has ``**``.
    """
    found = []
    for module, own in sources(repository).items():
        for node in own:
            if not (isinstance(node, ast.Call) and node.args):
                continue
            name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if name not in {"finding", "of"}:
                continue
            keywords = {k.arg for k in node.keywords if k.arg} if all(k.arg for k in node.keywords) else None
            place = f"{module}:{node.lineno}"
            found += [(place, code, keywords) for code in literal_codes(node.args[0])]
    return found


def texts(code: str) -> tuple[str, ...]:
    """Return the parts of a message, and the remedy."""
    message, remedy, _ = CATALOGUE[code]
    return (*message, remedy)


def fields(code: str) -> set[str]:
    """Return the names of the format fields of a catalogue entry."""
    return {re.split(r"[.\[]", name)[0] for text in texts(code) for _, name, _, _ in FORMAT.parse(text) if name}


@functools.cache
def literals(repository: Path) -> set[str]:
    """Return every string literal of the sources but places, as codes are also passed in variables."""
    found = set()
    for own in sources(repository).values():
        places = {
            id(node)
            for keyword in own
            if isinstance(keyword, ast.keyword) and keyword.arg == "place"
            for node in ast.walk(keyword.value)
        }
        constants = [node for node in own if isinstance(node, ast.Constant) and id(node) not in places]
        found |= {node.value for node in constants if isinstance(node.value, str)}
    return found


@pytest.mark.repository
def test_every_code_in_the_sources_is_in_the_catalogue(repository: Path) -> None:
    used, known = calls(repository), entries(repository)
    assert used
    assert [(place, code) for place, code, _ in used if code not in known] == []


@pytest.mark.repository
def test_every_literal_that_looks_like_a_code_is_in_the_catalogue(repository: Path) -> None:
    """Each literal ``domain.word`` of a known domain is a code of the catalogue, unless it is a file name."""
    known = entries(repository)
    domains = {code.split(".")[0] for code in known}
    alike = {
        text
        for text in literals(repository)
        if CODE.match(text) and text.split(".")[0] in domains and text.rpartition(".")[2] not in FILE_SUFFIXES
    }
    assert sorted(alike - set(known)) == []


@pytest.mark.repository
def test_every_field_of_a_message_is_given(repository: Path) -> None:
    lacking = [
        (place, code, fields(code) - ALWAYS - keywords)
        for place, code, keywords in calls(repository)
        if code in entries(repository) and keywords is not None and fields(code) - ALWAYS - keywords
    ]
    assert lacking == []


@pytest.mark.repository
def test_every_code_of_the_catalogue_is_used(repository: Path) -> None:
    inline = {whole[1] for text in literals(repository) if (whole := INLINE.match(text))}
    assert inline, "an entry of one place stands there"
    assert sorted(set(entries(repository)) - literals(repository) - inline) == []


@pytest.mark.repository
def test_entries_are_well_formed(repository: Path) -> None:
    for code, entry in entries(repository).items():
        *message, remedy = texts(code)
        assert CODE.match(code)
        assert all(message) and (remedy or entry.severity != "failure"), code
        assert "\n" not in "".join(message) + remedy, code
        assert not message[-1].endswith(".") and (not remedy.endswith(".") or remedy.endswith("...")), code
        assert [*message, remedy] == [" ".join(text.split()) for text in (*message, remedy)], code


@pytest.mark.behaviour
def test_entries_format_with_values_of_their_fields(repository: Path) -> None:
    """Every entry of the catalogue accepts values for its fields, shows each value once and keeps its other words."""
    for code in entries(repository):
        parts = [p for text in texts(code) for p in FORMAT.parse(OPTION.sub(r"option \1", text))]
        values: dict[str, object] = {name: 1.5 if kind else "WORD" for _, name, kind, _ in parts if name}
        lists = {name for _, name, kind, how in parts if name and (how or (kind and kind.isdecimal()))}
        values |= {name: ["WORD"] for name in lists} | {
            name.partition("[")[0]: [1.5] * 3 for name in values if "[" in name
        }
        found = finding(code, **values)
        shown = f"{found.message} {found.remedy}"
        assert "{" not in shown and "}" not in shown, code
        assert all(before.replace("(s)", "s") in shown for before, *_ in parts), code
        words = [name for _, name, kind, _ in parts if name and (not kind or name in lists)]
        assert shown.count("WORD") == len(words), code


@pytest.mark.repository
def test_no_code_has_two_entries() -> None:
    heads = re.compile(r"^([a-z0-9_.]+)(?: \(\w+\))?: ", re.M)
    modules = [import_module(f"fg_orient.model.messages.{name}") for name in MODULES]
    known = {code for module in modules for code in module.WORDS}
    codes = [code for module in modules for code in heads.findall(inspect.getsource(module)) if code in known]
    assert len(codes) == len(set(codes)) == len(known)


@pytest.mark.repository
def test_an_entry_has_parts_a_remedy_and_a_severity() -> None:
    """The parser joins lines, begins a part at +, a remedy at ->, and shares a remedy among consecutive codes."""
    table = "a.b (note): one\n    two: three\n    + , {four}\n    -> do\n    it\n"
    table += "c.c: last\nc.d: five\n    -> six\ne.e (note): x"
    assert words(table) == {
        "a.b": Entry(("one two: three", ", {four}"), "do it", "note"),
        "c.c": Entry(("last",), "six"),
        "c.d": Entry(("five",), "six"),
        "e.e": Entry(("x",), "", "note"),
    }


@pytest.mark.repository
def test_choices_are_offered_in_the_same_words(repository: Path) -> None:
    """No entry of the catalogue introduces a list of known values with other words than the standard ones."""
    others = re.compile(r"choose among|use one of|give one of \{|^known: \{known\}$|choose one of: ")
    assert [code for code in entries(repository) if any(others.search(text) for text in texts(code))] == []


@pytest.mark.behaviour
def test_one_problem_is_one_line_with_file_place_value_and_remedy() -> None:
    text = str(InputError.of("output.exists", file="out", option="out", value="two\nlines"))
    assert text.startswith("out, option out: ")
    assert "(found two lines)" in text
    assert text.endswith("; give another option out or add option overwrite")
    assert "\n" not in text


@pytest.mark.behaviour
def test_problems_of_one_error_are_listed_line_by_line() -> None:
    first, second = finding("output.exists", file="a"), finding("output.exists", file="b")
    error = FgOrientError(first, second)
    assert [line[0] for line in str(error).splitlines()] == ["a", "b"]
    assert [record["file"] for record in (p.as_dict() for p in error.problems)] == ["a", "b"]
