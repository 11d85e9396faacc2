"""Tables in Parquet and Arrow files give the same arrays, results and refusals as CSV tables."""

from __future__ import annotations

import decimal
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import feather, ipc, parquet

import fg_orient as fg
from fg_orient.formats import arrow
from fg_orient.formats.faults import Faults
from fg_orient.formats.points import COLUMNS, read_observations, read_points
from fg_orient.formats.points_write import write_observations, write_points
from fg_orient.formats.table_write import BINARY, write_table
from fg_orient.formats.tables import read_table
from fg_orient.model.names import Role
from fg_orient.simulate.block import BlockOptions, simulate_block
from tests.support.command import in_process

SIZES = {"left": (12000, 12000), "right": (12000, 12000)}
IDS = ["01", "1", "é, 2", "=x", "#7"]
FORMS = ("csv", "parquet", "arrow")


def observed(path: Path, ids: list[str] = IDS) -> tuple[Any, Faults]:
    faults = Faults(str(path))
    return read_observations(path, SIZES, ids, faults), faults


def arrays(observations: Any) -> list[bytes]:
    o = observations
    return [v.tobytes() for v in (o.image, o.point, o.line, o.sample, o.sigma_line_px, o.sigma_sample_px)]


def store(path: Path, columns: dict[str, Any] | pa.Table, **options: Any) -> Path:
    """Write a table with pyarrow alone."""
    table = columns if isinstance(columns, pa.Table) else pa.table(columns)
    if path.suffix == ".parquet":
        options = {name: "none" if value == "uncompressed" else value for name, value in options.items()}
        parquet.write_table(table, path, **options)
    else:
        feather.write_feather(table, str(path), **options)
    return path


@pytest.mark.oracle
@pytest.mark.parametrize("suffix", [".csv", *BINARY])
def test_written_observations_are_read_bit_by_bit(tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arrow, "ROW_GROUP", 3)  # several row groups
    rng = np.random.default_rng(3)
    image, point = np.divmod(rng.permutation(10), 5)
    pixels, sigma = rng.uniform(0.0, 11999.0, (10, 2)), rng.uniform(1e-3, 1.0, (10, 2))
    path = tmp_path / f"o{suffix}"
    names = list(SIZES)
    write_observations(path, [names[k] for k in image], [IDS[k] for k in point], pixels, sigma, comments=["made"])
    found, faults = observed(path)
    assert not faults.problems
    assert arrays(found.observations) == [v.tobytes() for v in (image, point, *pixels.T, *sigma.T)]


@pytest.mark.oracle
@pytest.mark.parametrize("suffix", [".csv", *BINARY])
def test_written_points_are_read_bit_by_bit(tmp_path: Path, suffix: str) -> None:
    """A written table of points is read with the same bits of coordinates and sigmas, and the same roles."""
    rng = np.random.default_rng(4)
    roles = [Role.CONTROL, Role.CONTROL, Role.TIE, Role.CHECK, Role.CONTROL]
    xyz, sigma, fixed = rng.normal(4e6, 1e5, (5, 3)), rng.uniform(0.1, 1.0, (5, 3)), np.array([0, 1, 0, 0, 0], bool)
    xyz[2] = sigma[2] = np.nan
    path, faults = tmp_path / f"p{suffix}", Faults("p")
    write_points(path, IDS, roles, xyz, sigma, kind="geocentric", fixed=fixed)
    found = read_points(path, "EPSG:4978", faults)
    assert found is not None and not faults.problems
    assert (list(found.points.ids), list(found.points.roles)) == (IDS, roles)
    control = [0, 1, 4]
    known = found.points.known
    assert known.ecef_m[control].tobytes() == xyz[control].tobytes() and known.fixed.tolist() == fixed.tolist()
    assert known.sigma_enu_m[[0, 4]].tobytes() == sigma[[0, 4]].tobytes()
    assert np.isnan(known.ecef_m[2:4]).all()
    assert found.withheld([IDS[3]]).open().ecef_m.tobytes() == xyz[3].tobytes()


def text(values: list[str], kind: str) -> Any:
    """Return the column of text as other programs may write it."""
    if kind == "dictionary":  # with a value that no row has
        distinct = ["nobody", *dict.fromkeys(values)]
        return pa.DictionaryArray.from_arrays([distinct.index(v) for v in values], distinct)
    return pa.array(values, {"large": pa.large_string(), "view": pa.string_view()}.get(kind, pa.string()))


@pytest.mark.oracle
@pytest.mark.parametrize("suffix", BINARY)
@pytest.mark.parametrize("compression", ["zstd", "lz4", "uncompressed"])
@pytest.mark.parametrize("kind", ["string", "large", "dictionary", "view"])
def test_types_of_other_programs(tmp_path: Path, suffix: str, compression: str, kind: str) -> None:
    """Ids may be text or whole numbers, and pixels may be single precision, decimal, whole numbers or text."""
    table = {
        "id": pa.array([7, 8, 7], pa.int32()), "image": text(["left", " left ", "right"], kind),
        "line": pa.array([0.1, 2.5, 3.0], pa.float32()), "sample": pa.array([4, 5, 6], pa.uint16()),
        "sigma_line_px": pa.array([decimal.Decimal("0.100")] * 3, pa.decimal128(9, 3)),
        "sigma_sample_px": text(["0.1", "1e-1", "+.5"], kind),
    }  # fmt: skip
    found, faults = observed(store(tmp_path / f"o{suffix}", table, compression=compression), ["7", "8"])
    assert not faults.problems
    expected = ([0, 0, 1], [0, 1, 0], [float(np.float32(0.1)), 2.5, 3.0], [4.0, 5.0, 6.0], [0.1] * 3, [0.1, 0.1, 0.5])
    o = found.observations
    assert [v.tolist() for v in (o.image, o.point, o.line, o.sample, o.sigma_line_px, o.sigma_sample_px)] == [*expected]


def good(**changed: Any) -> dict[str, Any]:
    """Return the columns of a sound table of two image points."""
    columns: dict[str, Any] = {"image": ["left", "right"], "id": ["01", "1"]}
    return {**columns, **{name: [1.5, 2.5] for name in COLUMNS[2:]}, **changed}


def without(name: str) -> dict[str, Any]:
    return {key: values for key, values in good().items() if key != name}


def twice() -> pa.Table:
    names = list(good())
    return pa.Table.from_arrays([pa.array(v) for v in (*good().values(), [1.0, 2.0])], [*names, names[-1]])


@pytest.mark.behaviour
@pytest.mark.parametrize("suffix", BINARY)
@pytest.mark.parametrize(("columns", "code", "place"), [
    (good(line=[1.5, None]), "table.cell_empty", "row 2, column line"),
    (good(line=[1.5, float("nan")]), "table.not_a_number", "row 2, column line"),
    (good(line=[None, None]), "table.cell_empty", "row 1, column line"),
    (good(line=["1", "1,5"]), "table.decimal_comma", "row 2, column line"),
    (good(line=[[1.5], [2.5]]), "table.column_type", "column line"),
    (good(line=[{"a": 1.5}, {"a": 2.5}]), "table.column_type", "column line"),
    (good(line=[True, False]), "table.column_type", "column line"),
    (good(id=[1.0, 2.0]), "table.column_type", "column id"),
    (good(id=[b"01", b"1"]), "table.column_type", "column id"),
    (good(id=["01", None]), "observations.point_unknown", "row 2, column id"),
    (good(id=["01", "2"]), "observations.point_unknown", "row 2, column id"),
    (good(id=["01", "a\nb"]), "table.text", "row 2, column id"),
    (good(id=["01", "x" * 10_001]), "table.text", "row 2, column id"),
    (good(image=["left", "left"], id=["1", "1"]), "observations.twice", "row 2, column id"),
    (good(sample=[1.5, 12000.0]), "observations.outside", "row 2, column sample"),
    (good(sigma_line_px=[0.0, 1.0]), "observations.sigma_not_positive", "row 1, column sigma_line_px"),
    (good(__index_level_0__=[1, 2]), "table.column_unknown", "the columns"),
    (without("line"), "table.column_missing", "the columns"),
    (twice(), "table.column_twice", "the columns"),
    (pa.table(good()).slice(0, 0), "table.no_records", "the columns"),
    (pa.table(good()).replace_schema_metadata({"fg_orient.schema": "9"}), "table.version", ""),
])  # fmt: skip
def test_faults_name_row_and_column(tmp_path: Path, suffix: str, columns: Any, code: str, place: str) -> None:
    path = tmp_path / f"o{suffix}"
    table = columns if isinstance(columns, pa.Table) else pa.table(columns)
    if suffix == ".parquet":
        parquet.write_table(table, path)
    else:
        with ipc.new_file(str(path), table.schema) as writer:
            writer.write_table(table)
    found, faults = observed(path)
    assert found is None and (faults.problems[0].code, faults.problems[0].place) == (code, place)
    line = str(faults.problems[0])
    assert line.startswith(str(path)) and "\n" not in line and faults.problems[0].remedy
    if code == "observations.twice":
        assert "first on row 1" in line


@pytest.mark.behaviour
@pytest.mark.parametrize("suffix", BINARY)
@pytest.mark.parametrize(("change", "code"), [
    (lambda data: data[:-20], "table.damaged"),
    (lambda data: data[:6], "table.damaged"),
    (lambda data: b"", "table.other_form"),
    (lambda data: b"image,id,line,sample\n", "table.other_form"),
    (lambda data: data[:6] + bytes(len(data) - 6), "table.damaged"),
])  # fmt: skip
def test_files_that_are_not_what_their_name_says(
    tmp_path: Path, suffix: str, change: Callable[[bytes], bytes], code: str
) -> None:
    path = store(tmp_path / f"o{suffix}", good())
    path.write_bytes(change(path.read_bytes()))
    found, faults = observed(path)
    assert found is None and [p.code for p in faults.problems] == [code]
    assert "\n" not in str(faults.problems[0]) and faults.problems[0].remedy


@pytest.mark.behaviour
@pytest.mark.parametrize("suffix", BINARY)
def test_missing_files_folders_and_binary_tables_named_csv(tmp_path: Path, suffix: str) -> None:
    assert observed(tmp_path / f"none{suffix}")[1].codes == {"table.missing_file"}
    (tmp_path / f"folder{suffix}").mkdir()
    assert observed(tmp_path / f"folder{suffix}")[1].codes == {"table.unreadable"}
    path = store(tmp_path / f"o{suffix}", good()).rename(tmp_path / "o.csv")
    assert observed(path)[1].codes == {"table.other_form"}


@pytest.mark.behaviour
@pytest.mark.parametrize("suffix", BINARY)
def test_damaged_bytes_are_faults_or_leave_the_values(tmp_path: Path, suffix: str) -> None:
    """A damaged table gives no values and an error, or is read; values of Parquet then do not change.

    Parquet has sums of its pages; of an Arrow file only the structure is checked.
    """
    rng = np.random.default_rng(6)
    path = tmp_path / f"o{suffix}"
    write_observations(path, ["left", "right"] * 5, np.repeat(IDS, 2).tolist(), rng.uniform(1, 99, (10, 2)), (0.1, 0.2))
    data = path.read_bytes()
    sound = arrays(observed(path)[0].observations)
    for _ in range(200):
        damaged = bytearray(data)
        for at in rng.integers(4, len(data), rng.integers(1, 4)):
            damaged[at] ^= 1 << rng.integers(8)
        path.write_bytes(damaged)
        found, faults = observed(path)
        assert (found is None) == bool(faults)
        assert found is None or suffix != ".parquet" or arrays(found.observations) == sound


@pytest.mark.behaviour
@pytest.mark.parametrize("suffix", BINARY)
def test_a_table_larger_than_the_memory_is_refused_before_it_is_read(
    tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A table above the memory limit is refused with rows and columns before a cell is read.

    A column that repeats one value has only a few bytes in the file.
    """
    words = {"image": ["a"] * 100_000, "id": ["b"] * 100_000}
    columns = good(**words, **{name: np.zeros(100_000) for name in COLUMNS[2:]})
    path = store(tmp_path / f"o{suffix}", columns, compression="zstd")
    assert path.stat().st_size < 500_000
    monkeypatch.setattr(arrow, "allowed_bytes", lambda limit: 9_000_000)
    monkeypatch.setattr(arrow, "_texts", None)  # nothing is read
    faults = observed(path)[1]
    assert faults.codes == {"table.memory"} and "100000 rows of 6 columns" in str(faults.problems[0])


@pytest.mark.behaviour
def test_without_pyarrow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without pyarrow each command on binary tables ends with exit code 2 and names the package to install."""
    project = simulate_block(tmp_path / "block", BlockOptions(points=20))
    path = store(tmp_path / "o.parquet", good())
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(fg.FgOrientError, match=r"o\.parquet: .*pip install 'fg-orient\[arrow\]'"):
        observed(path)
    for words in (
        ("adjust", project, "--tables", "parquet"), ("simulate", "block", "--tables", "arrow", "--out", tmp_path / "b"),
        ("convert", project.parent / "points.csv", "--from", "csv", "--out", tmp_path / "p.feather"),
    ):  # fmt: skip
        ended = in_process(*words, "--json")
        assert (ended.code, ended.json["errors"][0]["code"]) == (2, "table.no_pyarrow")
    assert {p.name for p in tmp_path.iterdir()} == {"block", "o.parquet"} and not (tmp_path / "block/result").exists()


@pytest.mark.behaviour
@pytest.mark.parametrize("suffix", [".parquet", ".arrow"])
def test_a_table_is_read_by_row_groups(tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """All cells of all row groups are read, and each call converts the cells of one group only."""
    monkeypatch.setattr(arrow, "ROW_GROUP", 4)
    path, faults, sizes = tmp_path / f"t{suffix}", Faults("t"), []
    columns = {"id": [f"p{k % 3 + k // 6}" for k in range(10)], "x_m": np.arange(10.0), "n_rays": [*range(9), None]}
    write_table(path, columns)
    numbers = arrow._numbers
    monkeypatch.setattr(arrow, "_numbers", lambda pa, column: (sizes.append(len(column)), numbers(pa, column))[1])
    whole = read_table(path, [("id", "x_m", "n_rays")], faults)
    assert whole is not None and not faults.problems
    assert list(whole.cells["n_rays"]) == [*map(str, range(9)), ""] and list(whole.cells["id"]) == columns["id"]
    assert whole.numbers("x_m")[:, 0].tolist() == columns["x_m"].tolist()
    assert sizes == [4, 4, 4, 4, 2, 2]


@pytest.mark.behaviour
def test_written_types(tmp_path: Path) -> None:
    """A table has the types text, whole number, floating-point number and truth value; an empty cell is null."""
    columns = {"id": ["a", ""], "degree": [1.0, float("nan")], "x_m": np.array([0.5, np.inf]), "yes": [True, None]}
    write_table(tmp_path / "t.parquet", columns, ["crs: EPSG:4979"])
    table = parquet.read_table(tmp_path / "t.parquet")
    assert table.to_pylist() == [
        {"id": "a", "degree": 1, "x_m": 0.5, "yes": True}, dict.fromkeys(columns),
    ]  # fmt: skip
    assert [str(one.type) for one in table.schema] == ["string", "int64", "double", "bool"]
    assert table.schema.metadata[b"fg_orient.schema"] == b"1"
    assert arrow.comments_of(tmp_path / "t.parquet", Faults("")) == "# crs: EPSG:4979"


@pytest.fixture(scope="module")
def projects(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return one block in each form."""
    folder = tmp_path_factory.mktemp("forms")
    return {form: simulate_block(folder / form, BlockOptions(points=60, tables=form)) for form in FORMS}


@pytest.mark.consistency
def test_a_block_and_its_results_are_those_of_csv(projects: dict[str, Path], tmp_path: Path) -> None:
    """A block of binary tables equals that of CSV bit by bit, and so do the result tables that are read again."""
    blocks = {form: fg.read_project(path) for form, path in projects.items()}
    first = blocks["csv"]
    for block in blocks.values():
        assert block.points.ids == first.points.ids and block.points.roles == first.points.roles
        assert arrays(block.observations) == arrays(first.observations)
        assert block.points.known.ecef_m.tobytes() == first.points.known.ecef_m.tobytes()
    results = {}
    for form, block in blocks.items():
        fg.adjust(block, snoop=True, tables=form).save(tmp_path / form)
        names = {path.name for path in (tmp_path / form).glob(f"*.{form}")}
        assert names == {f"{name}.{form}" for name in ("eop", "points", "residuals", "accuracy", "outliers")}
        results[form] = fg.read_result(tmp_path / form)
    for result in results.values():
        for name, table in results["csv"].tables.items():
            found = result.tables[name]
            assert found.words == table.words and list(found.columns) == list(table.columns)
            assert [v.tobytes() for v in found.figures.values()] == [v.tobytes() for v in table.figures.values()]
        assert result.to_frame("points").equals(results["csv"].to_frame("points"))
        assert result.to_geo() == results["csv"].to_geo()
    assert "residuals.parquet" in (tmp_path / "parquet" / "report.html").read_text("utf-8")


@pytest.mark.consistency
@pytest.mark.parametrize("form", ["parquet", "arrow"])
def test_commands_on_result_folders(projects: dict[str, Path], tmp_path: Path, form: str) -> None:
    """``adjust``, ``report``, ``replay`` and ``--from`` work on binary result tables, with the figures of CSV."""
    figures = {}
    for one in ("csv", form):
        project, out = projects[one], projects[one].parent / "result"
        assert in_process("validate", project).code == 0
        for _ in range(2):
            assert in_process("adjust", project, "--tables", one, "--out", out, "--overwrite").code == 0
        ended = in_process("report", out, "--truth", project.parent / "truth", "--json")
        assert ended.code == 0
        figures[one] = ended.json["truth"]
        again = in_process("replay", out, "--out", tmp_path / f"{one}-replay", "--json")
        assert (again.code, again.json["equal"], len(again.json["tables"])) == (0, True, 4)
        assert in_process("adjust", project, "--from", out, "--out", tmp_path / f"{one}-from").code == 0
        left = json.loads((tmp_path / f"{one}-from" / "result.json").read_text("utf-8"))["provenance"]["repeat"][
            "start"
        ]
        assert set(left["files"]) == {"result.json", "covariance.npz", f"eop.{one}", f"points.{one}"}
    assert figures[form] == figures["csv"]
    (out / f"points.{form}").write_bytes(b"")
    ended = in_process("report", out, "--json")
    assert (ended.code, ended.json["errors"][0]["code"]) == (2, "manifest.incomplete")


@pytest.mark.consistency
@pytest.mark.parametrize("suffix", BINARY)
def test_conversion_to_and_fro(projects: dict[str, Path], tmp_path: Path, suffix: str) -> None:
    """A table that is converted to a binary format and back has the same bytes, including the comment with the CRS."""
    folder = projects["csv"].parent
    tables = (folder / "points.csv", folder / "observations.csv")
    steps = [("--from", "csv", *tables, "--to", "csv", "--out", tmp_path / "a.csv"),
             (tmp_path / "a.csv", tmp_path / "a_observations.csv", "--from", "csv", "--out", tmp_path / f"b{suffix}"),
             (tmp_path / f"b{suffix}", tmp_path / f"b_observations{suffix}", "--to", "csv", "--out",
              tmp_path / "c.csv")]  # fmt: skip
    for words in steps:
        ended = in_process("convert", *words, "--json")
        assert ended.code == 0, ended.json
    for name in ("", "_observations"):
        assert (tmp_path / f"c{name}.csv").read_bytes() == (tmp_path / f"a{name}.csv").read_bytes()
