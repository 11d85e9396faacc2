"""Computing by columns gives the results of computing by rows: tables, Jacobians, cofactors of points."""

from __future__ import annotations

import csv
import io
import re
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fg_orient.adjustment.problem import State, compile_problem
from fg_orient.adjustment.rows import image_rows, linearised, residuals, rows_by_image
from fg_orient.formats import columns, tables
from fg_orient.formats.faults import Faults
from fg_orient.formats.points import COLUMNS, read_observations, read_points
from fg_orient.formats.table_write import cell_text
from fg_orient.model.block import Block
from fg_orient.model.errors import InputError
from fg_orient.orientation.orient import adjust
from fg_orient.result.plain import Table, read_table
from fg_orient.simulate.block import BlockOptions, grid_block
from fg_orient.simulate.mixed import MixedOptions, mixed_block
from tests.support.full_statistics import Full
from tests.support.scalar_rows import scalar_rows

quiet = settings(derandomize=True, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
words = st.text(st.characters(codec="utf-8", exclude_characters="\r\0"), min_size=1, max_size=6)
figures = st.one_of(st.sampled_from([0.0, -0.0, -1.5, float("nan"), float("inf")]), st.floats())


def digits(cell: str) -> str:
    """Return the significant digits in the text of a number."""
    return re.sub(r"[^0-9]", "", cell.partition("e")[0]).strip("0")


@pytest.mark.oracle
@quiet
@given(st.lists(st.tuples(words, figures, st.integers(), figures), min_size=1, max_size=9))
def test_written_table_has_the_cells_of_its_rows(tmp_path: Path, rows: list[tuple[str, float, int, float]]) -> None:
    """A written table has the cells of its rows, and numbers with no more digits than Python's.

    The module csv reads it; apostrophes before formulas are removed.
    """
    ids, first, counts, second = zip(*rows, strict=True)
    place = np.arange(len(rows))[::-1]
    given = {"id": ids, "x,m": np.array(first), "n": np.array(counts, object), "y": np.array(second),
               "to": [ids[k] for k in place]}  # fmt: skip
    Table(given).write(tmp_path / "t.csv")
    text = (tmp_path / "t.csv").read_text("utf-8")
    found = list(csv.reader(io.StringIO(text, newline="")))[1:]
    for k, (name, x, n, y) in enumerate(rows):
        for cell, v in zip((found[k][1], found[k][3]), (x, y), strict=True):
            assert (struct.pack("d", float(cell)) == struct.pack("d", v)) if np.isfinite(v) else cell == ""
            assert len(digits(cell)) <= len(digits(repr(v)))
        assert (cell_text(found[k][0]), found[k][2], cell_text(found[k][4])) == (name, str(n), ids[place[k]])


@pytest.mark.oracle
def test_table_longer_than_a_chunk_reads_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fg_orient.formats.table_write.ROWS", 7)
    values, ids = np.random.default_rng(1).normal(size=40), [f"p{k}" for k in range(40)]
    values[3] = np.nan
    ids[39] = 'p"39'
    Table({"id": ids, "x_m": values}).write(tmp_path / "t.csv")
    with (tmp_path / "t.csv").open(newline="", encoding="utf-8") as stream:
        rows = list(csv.reader(stream))
    cells = ["" if np.isnan(x) else repr(x) for x in values.tolist()]
    assert rows == [["id", "x_m"], *map(list, zip(ids, cells, strict=True))]
    table = read_table(tmp_path / "t.csv")
    assert table.words["id"] == ids and len(table) == 40
    np.testing.assert_array_equal(table.figures["x_m"], values)
    (tmp_path / "t.csv").write_text("id,x_m\na,1\nb\n")
    with pytest.raises(InputError, match=r"line 3: .*does not have 2 cells, one for each column"):
        read_table(tmp_path / "t.csv")


CELLS = st.sampled_from(["1.5", "7", "-0.4", "-2", "1e3", "", "x", "1,5", " 2 ", "inf", "fixed", "0", '"3"', "a", "b"])


LINES = st.lists(st.one_of(
    st.tuples(*[st.one_of(CELLS, st.floats(allow_nan=False).map(repr), words)] * 3).map(",".join),
    st.sampled_from(["", "# a comment", ",,", "1,2", "1,2,3,", " 4,5,6", "x" * 120, "é,1,2", "1,2,3\r"]),
    st.tuples(*[st.integers(-9, 10**20).map(str)] * 3).map(",".join),
), max_size=6)  # fmt: skip


@pytest.mark.consistency
@quiet
@given(LINES, LINES, st.booleans())
def test_a_table_by_columns_is_that_line_by_line(
    tmp_path: Path, before: list[str], after: list[str], ended: bool
) -> None:
    """A table read by columns has the cells, numbers, masks, line numbers and errors of one read line by line."""
    comments = [line for line in before if line.startswith("#") or not line]
    text = "\n".join([*comments, "a,b,c", *after]) + "\n" * ended
    (tmp_path / "t.csv").write_text(text, "utf-8", newline="")
    seen = []
    for read in (columns.regular, lambda text, longest: None):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(tables, "regular", read)
            patch.setattr(tables, "MAX_LINE", 100)
            patch.setattr(columns, "CHUNK", 2)
            faults = Faults("t.csv")
            table = tables.read_table(tmp_path / "t.csv", [("a", "b", "c")], faults)
            found: list[object] = []
            if table is not None:
                some = np.arange(len(table)) % 2 == 0
                numbers = [table.numbers("a", "c"), table.numbers("b", rows=some)]
                masks = [table.where("a", cell).tolist() for cell in ("", "fixed", "1", "1.5")]
                cells = [list(table.cells[name]) for name in table.columns]
                rows = [table.row(k) for k in range(len(table))]
                table.report(faults)
                found = [cells, [n.tobytes() for n in numbers], masks, rows, table.lines.tolist()]
            seen.append((found, [(p.code, p.place, p.message) for p in faults.problems]))
    assert seen[0] == seen[1]


@pytest.mark.consistency
@quiet
@given(st.lists(st.tuples(st.integers(0, 5), CELLS), max_size=2), st.booleans())
def test_observations_are_refused_if_and_only_if_a_fault_is_listed(
    tmp_path: Path, changes: list[tuple[int, str]], twice: bool
) -> None:
    rows = [["left", "a", "1", "2", "0.5", "0.5"], ["left", "b", "3.25", "4", "0.5", "0.4"]]
    rows += [["right", "b", "1", "2", "0.5", "0.5"]] * (1 + twice)
    for column, cell in changes:
        rows[1] = [*rows[1][:column], cell, *rows[1][column + 1 :]]
    text = "\n".join([",".join(COLUMNS), *(",".join(row) for row in rows)])
    (tmp_path / "o.csv").write_text(text, "utf-8")
    faults = Faults("o.csv")
    sizes = {"left": (10, 10), "right": None}
    found = read_observations(tmp_path / "o.csv", sizes, ["a", "b", "x"], faults)
    assert (found is None) == bool(faults)


@pytest.mark.oracle
@quiet
@given(st.lists(st.tuples(st.integers(0, 2), st.integers(2, 7), CELLS), max_size=2))
def test_points_without_faults_have_the_numbers_of_their_cells(
    tmp_path: Path, changes: list[tuple[int, int, str]]
) -> None:
    """Points without errors have the numbers of their cells, and an error is reported for every other table.

    Earth-fixed coordinates are not transformed.
    """
    rows = [["c", "control", "30", "40", "5", "1", "1", "2"], ["k", "check", "31", "40.5", "6", "1", "1", "2"],
            ["t", "tie", "", "", "", "", "", ""]]  # fmt: skip
    for row, column, cell in changes:
        rows[row] = [*rows[row][:column], cell, *rows[row][column + 1 :]]
    header = "id,role,x_m,y_m,z_m,sigma_east_m,sigma_north_m,sigma_up_m"
    (tmp_path / "p.csv").write_text("\n".join([header, *(",".join(row) for row in rows)]), "utf-8")
    faults = Faults("p.csv")
    found = read_points(tmp_path / "p.csv", "EPSG:4978", faults)
    cells = [[cell.strip().strip('"') for cell in row] for row in rows]
    fixed = cells[0][5:] == ["fixed"] * 3
    numbers = [*cells[0][2 : 5 if fixed else 8], *cells[1][2:]]
    sound = all(re.fullmatch(r"-?[0-9.]+(e[0-9]+)?", cell) for cell in numbers) and not any(cells[2][2:])
    sound = sound and all(float(cell) > 0.0 for cell in [*([] if fixed else cells[0][5:]), *cells[1][5:]])
    assert bool(faults) != sound
    if sound:
        assert found is not None
        known = found.points.known
        assert known.ecef_m[0].tolist() == [float(cell) for cell in cells[0][2:5]] and known.fixed[0] == fixed
        assert fixed or known.sigma_enu_m[0].tolist() == [float(cell) for cell in cells[0][5:]]
        assert np.isnan(known.ecef_m[1:]).all()


@pytest.fixture(scope="module")
def block() -> Block:
    options = BlockOptions(points=60)
    return grid_block(options)[0]


@pytest.mark.consistency
@pytest.mark.parametrize("degree", [None, 2])
def test_rows_of_an_image_are_those_of_its_equation(block: Block, degree: int | None) -> None:
    problem = compile_problem(replace(block, options=replace(block.options, eop_set=20, look_polynomial=degree)))
    rng = np.random.default_rng(3)
    state = State(rng.normal(size=problem.start.image.shape), problem.start.ground + rng.normal(size=(60, 3)))
    value, j_image, j_ground = scalar_rows(problem, state)
    every = rows_by_image(problem)
    assert sorted(np.concatenate(every).tolist()) == list(range(len(value)))
    for k, rows in enumerate(every):
        found, d_image, d_ground = image_rows(problem, state, k, rows, jacobian=True)
        assert (problem.observations.image[rows] == k).all()
        np.testing.assert_allclose(found, value[rows], rtol=1e-12, atol=1e-10)
        np.testing.assert_allclose(d_ground, np.array([j_ground[r] for r in rows]), rtol=1e-11, atol=1e-14)
        expected = np.array([j_image[r] for r in rows])
        np.testing.assert_allclose(d_image, expected, rtol=1e-11, atol=1e-12 * np.abs(expected).max())


@pytest.mark.consistency
def test_rows_of_many_images_are_those_of_their_equations() -> None:
    """Rows computed for many images at once equal those of single equations, for all, some or no image points.

    Images differ in kind and number of unknowns.
    """
    problem = compile_problem(mixed_block(MixedOptions(seed=3, points=40))[0])
    value, j_image, j_ground = scalar_rows(problem, problem.start)
    some = np.random.default_rng(1).permutation(len(value))[:20]
    widest = max(len(parameters) for parameters in problem.parameters)
    for rows, chosen in ((np.arange(len(value)), None), (some, some), (some[:0], some[:0])):
        found, d_image, d_ground = linearised(problem, problem.start, chosen)
        assert d_image.shape == (len(rows), 2, widest)
        np.testing.assert_allclose(found, value[rows], rtol=1e-12, atol=1e-10)
        for at, row in enumerate(rows.tolist()):
            own = j_image[row].shape[1]
            scale = np.abs(j_image[row]).max()
            np.testing.assert_allclose(d_image[at, :, :own], j_image[row], rtol=1e-11, atol=1e-12 * scale)
            assert not d_image[at, :, own:].any()
            np.testing.assert_allclose(d_ground[at], j_ground[row], rtol=1e-11, atol=1e-14)
    np.testing.assert_array_equal(residuals(problem, problem.start), linearised(problem, problem.start)[0])


@pytest.mark.oracle
@pytest.mark.parametrize("backend", ["schur", "graph", "dense"])
def test_cofactors_of_all_points_are_those_of_the_full_matrix(
    block: Block, monkeypatch: pytest.MonkeyPatch, backend: str
) -> None:
    """Cofactors of all points equal those of the full matrix, for any size of chunks; fixed points have zeros."""
    fixed = block.points.known.fixed.copy()
    fixed[np.flatnonzero(np.isfinite(block.points.known.ecef_m).all(axis=1))[:2]] = True
    points = replace(block.points, known=replace(block.points.known, fixed=fixed))
    solution = adjust(replace(block, points=points), backend=backend)
    found, full = solution.cofactors, Full.of(solution.problem, solution.state)
    assert found is not None
    each = np.zeros((60, 3, 3))
    for j in np.flatnonzero(full.problem.active):
        each[j] = full.unknowns[full.problem.point_slice(j), full.problem.point_slice(j)]
        assert np.allclose(found.point(j), each[j], rtol=1e-7, atol=0.0)
    assert not each[fixed].any() and (np.einsum("nii->ni", each)[~fixed] > 0.0).all()
    scale = np.sqrt(np.einsum("nii->ni", each)) + fixed[:, None]
    order = np.random.default_rng(0).permutation(60)
    for chunk, limit in ((50_000, 6000), (11, 6000), (50_000, 0)):
        monkeypatch.setattr("fg_orient.adjustment.cofactors.CHUNK", chunk)
        monkeypatch.setattr("fg_orient.adjustment.cofactors.WHOLE_LIMIT", limit)
        error = (found.points(order) - each[order]) / (scale[order, :, None] * scale[order, None, :])
        assert np.abs(error).max() < 1e-8
    assert found.points(np.zeros(0, np.intp)).shape == (0, 3, 3)
