"""The readers read exactly what the writers write, and the standard library reads the same."""

from __future__ import annotations

import csv
import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fg_orient.formats.faults import Faults
from fg_orient.formats.points import read_observations, read_points
from fg_orient.formats.points_write import write_observations, write_points, write_project
from fg_orient.formats.project import read_project
from fg_orient.formats.table_write import cell_text
from fg_orient.model.block import Options
from fg_orient.model.names import Role

names = (
    st.text(st.characters(exclude_categories=["Cs", "Cc"]), min_size=1, max_size=12)
    .filter(lambda s: s == s.strip())
)  # fmt: skip
id_lists = st.lists(names, min_size=1, max_size=6, unique=True)
sigmas = st.floats(1e-6, 1e6)


def rows_of(path: Path, comments: int = 0) -> list[dict[str, str]]:
    """Read a table by the standard library alone."""
    with path.open(newline="", encoding="utf-8") as stream:
        for _ in range(comments):
            next(stream)
        return list(csv.DictReader(stream))


@pytest.mark.oracle
@given(id_lists, st.data())
def test_points(tmp_path_factory, ids, data):
    path = tmp_path_factory.mktemp("p") / "points.csv"
    draw = data.draw
    n = len(ids)
    roles = [draw(st.sampled_from(Role)) for _ in ids]
    xyz = np.array([[draw(st.floats(-7e6, 7e6)) for _ in range(3)] for _ in ids])
    sigma = np.array([[draw(sigmas) for _ in range(3)] for _ in ids])
    tie = np.array([role is Role.TIE for role in roles])
    fixed = np.array([role is Role.CONTROL and draw(st.booleans()) for role in roles])
    xyz[tie], sigma[tie | fixed] = np.nan, np.nan
    write_points(path, ids, roles, xyz, sigma, kind="geocentric", fixed=fixed, comments=["a, b"])
    rows = rows_of(path, comments=1)
    assert [(cell_text(row["id"]), row["role"]) for row in rows] == [
        (name, str(role)) for name, role in zip(ids, roles, strict=True)
    ]
    assert [row["sigma_up_m"] == "fixed" for row in rows] == fixed.tolist()
    for columns, numbers in (("x_m y_m z_m", xyz), ("sigma_east_m sigma_north_m sigma_up_m", sigma)):
        cells = [[row[name] for name in columns.split()] for row in rows]
        written = [[float(cell) if cell not in ("", "fixed") else np.nan for cell in row] for row in cells]
        np.testing.assert_array_equal(written, numbers)
    faults = Faults(str(path))
    read = read_points(path, "EPSG:4978", faults)
    assert not faults, faults.problems
    assert read is not None and read.points.ids == tuple(ids) and read.points.roles == tuple(roles)
    control = read.points.where(Role.CONTROL)
    np.testing.assert_array_equal(read.points.known.ecef_m[control], xyz[control])
    np.testing.assert_array_equal(read.points.known.sigma_enu_m[control], sigma[control])
    np.testing.assert_array_equal(read.points.known.fixed, fixed)
    check = read.points.where(Role.CHECK)
    opened = read.withheld([ids[k] for k in check]).open()
    np.testing.assert_array_equal(opened.ecef_m, xyz[check])
    np.testing.assert_array_equal(opened.sigma_enu_m, sigma[check])
    assert opened.fixed.sum() == 0 and len(opened.fixed) == len(check) <= n


@pytest.mark.oracle
@given(id_lists, id_lists, st.data())
def test_observations(tmp_path_factory, images, points, data):
    path = tmp_path_factory.mktemp("o") / "observations.csv"
    pairs = data.draw(st.lists(st.tuples(st.sampled_from(images), st.sampled_from(points)), min_size=1, unique=True))
    pixels = np.array([[data.draw(st.floats(-0.5, 999.5)) for _ in range(2)] for _ in pairs])
    sigma = np.array([[data.draw(sigmas) for _ in range(2)] for _ in pairs])
    write_observations(path, [p[0] for p in pairs], [p[1] for p in pairs], pixels, sigma)
    rows = rows_of(path)
    assert [(cell_text(row["image"]), cell_text(row["id"])) for row in rows] == pairs
    names = ("line", "sample", "sigma_line_px", "sigma_sample_px")
    np.testing.assert_array_equal([[float(row[name]) for name in names] for row in rows], np.hstack([pixels, sigma]))
    faults = Faults(str(path))
    read = read_observations(path, dict.fromkeys(images, (1000, 1000)), points, faults)
    assert not faults, faults.problems
    assert read is not None
    o = read.observations
    assert [(images[i], points[p]) for i, p in zip(o.image, o.point, strict=True)] == pairs
    np.testing.assert_array_equal(np.stack([o.line, o.sample], axis=1), pixels)
    np.testing.assert_array_equal(np.stack([o.sigma_line_px, o.sigma_sample_px], axis=1), sigma)


OPTIONS = [
    Options(),
    Options(
        eop_set=3, look_polynomial=2, priors=False, position_sigma_m=(1.0, 2e-7, 3.0),
        velocity_sigma_m_s=(1.0, 2.0, 3.0), attitude_sigma_rad=(1e-6, 1e-9, 1e-12),
        look_sigma_rad=3e-5, small_angle=True, backend="dense", solver="cholesky_elimination",
        optimizer="dogleg", max_iterations=7, check_points="exclude", datum="priors", rpc_compensation="affine",
        rpc_shift_sigma_px=3.5, rpc_linear_sigma_px=0.25, memory_limit_gb=1.5,
        loss="tls", gnc=True, inlier_probability=0.975, robust_start="lts", robust_scale="mad",
        statistics="full", tables="parquet", image_unknowns=("x_0", "roll_1"),
        variance_components=("image", "height"), snoop=True, snoop_kind="points",
        outlier_test="pope", outlier_level=0.01, multiple_testing="holm", look_shared=True, curve_intervals=4,
        jitter="auto", jitter_curves=("left:roll:16:3e-6",),
        curve_position_sigma_m=2.5, curve_attitude_sigma_rad=3e-6, accept=("gross_error:point 12<=20", "sigma0"),
        required_accuracy_m=0.5, regularisation="tikhonov", kappa=0.5, kappa_rule="gcv", penalty="laplace",
        penalty_deviation=True, median_rejection=4.0, loss_quantile=0.25, rank_cut=1e-7, regularised_units="columns",
    ),
]  # fmt: skip


@pytest.mark.consistency
@pytest.mark.parametrize("options", OPTIONS)
def test_project(folder, options):
    changed = {f.name for f in dataclasses.fields(Options) if getattr(OPTIONS[1], f.name) == f.default}
    assert not changed, "the second case must change every option"
    write_project(
        folder.project, name="a \"quoted\" \\ näme\x7f", images=[("left", "left.DIM"), ("right", "right.DIM")],
        options=options, comments=["made by a test"],
    )  # fmt: skip
    block = read_project(folder.project)
    assert block.options == options and block.name == 'a "quoted" \\ näme\x7f'


@pytest.mark.behaviour
@pytest.mark.parametrize("name", ["", " a", "a\t", "a\nb", "a\rb", "a\0b"])
def test_ids_that_would_not_read_back_are_refused_and_leave_no_file(tmp_path: Path, name: str):
    with pytest.raises(ValueError, match="cannot be written"):
        write_points(tmp_path / "p.csv", [name], [Role.TIE], np.full((1, 3), np.nan), np.full((1, 3), np.nan))
    assert not list(tmp_path.iterdir())
