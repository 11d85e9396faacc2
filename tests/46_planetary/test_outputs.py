"""The tests check the tables, report and files of results on another body, and its coordinates."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import fg_orient as fg
from fg_orient.cli.app import app
from fg_orient.geodesy.bodies import Body, body_named, coordinates_on, ground_on, points_on
from fg_orient.model.errors import InputError
from fg_orient.report.geofiles import export
from tests.support.planetary_files import RADIUS_KM, write_block

MARS = Body("Mars", (3396190.0, 3396190.0, 3376200.0))
PHOBOS = Body("Phobos", (13000.0, 11400.0, 9100.0))


@pytest.mark.oracle
@pytest.mark.parametrize("body", [MARS, PHOBOS], ids=lambda b: b.name)
def test_rays_meet_the_ellipsoid(body: Body, rng: np.random.Generator) -> None:
    """Rays meet the ellipsoid of the body at the nearer point, and at a height the radius is longer by it."""
    away = rng.normal(size=(200, 3))
    position = 3.0 * max(body.radii_m) * away / np.linalg.norm(away, axis=1, keepdims=True)
    aim = rng.normal(size=(200, 3)) * 0.3 * min(body.radii_m)
    direction = aim - position
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    ground = body.intersect(position, direction, np.zeros(200))
    hit = np.isfinite(ground).all(axis=1)
    assert hit.sum() > 150
    assert np.abs(np.sum((ground[hit] / body.radii_m) ** 2, axis=1) - 1.0).max() < 1e-9
    # the nearer of the two points: the surface faces the sensor
    assert (np.sum(ground[hit] / np.square(body.radii_m) * direction[hit], axis=1) < 0.0).all()
    lon, lat, height = coordinates_on(body, ground[hit])
    assert np.abs(height).max() < 1e-6
    raised = ground_on(body, lon, lat, np.full(len(lon), 500.0))
    np.testing.assert_allclose(np.linalg.norm(raised, axis=1) - np.linalg.norm(ground[hit], axis=1), 500.0, atol=1e-6)
    again = body.intersect(position[hit], direction[hit], np.full(hit.sum(), 500.0))
    seen = np.isfinite(again).all(axis=1)
    np.testing.assert_allclose(coordinates_on(body, again[seen])[2], 500.0, atol=1e-5)


@pytest.mark.truth
@pytest.mark.parametrize(
    ("name", "radii"), [("Moon", (1737400.0,) * 3), ("mars", (3396190.0, 3396190.0, 3376200.0)),
                        ("IAU_2015:19902", (2440530.0, 2440530.0, 2438260.0)), ("Venus", (6051800.0,) * 3)],
)  # fmt: skip
def test_bodies_by_name(name: str, radii: tuple[float, float, float]) -> None:
    """A body found by name or code has the radii of Archinal et al. 2018 (IAU 2015)."""
    np.testing.assert_allclose(body_named(name).radii_m, radii, rtol=1e-9)


@pytest.mark.oracle
@pytest.mark.parametrize("code", ["IAU_2015:30100", "IAU_2015:49902", "iau_2015:49900", "IAU_2015:29900"])
def test_longitude_and_latitude_of_the_iau(code: str, rng: np.random.Generator) -> None:
    """Coordinates of IAU codes are planetocentric, with heights along the radius above the sphere or ellipsoid."""
    lon, lat = rng.uniform(-180.0, 180.0, 30), rng.uniform(-89.0, 89.0, 30)
    height = rng.uniform(-5e3, 9e3, 30)
    a, b = {"30100": (1737400.0,) * 2, "49902": (3396190.0, 3376200.0), "49900": (3396190.0,) * 2,
            "29900": (6051800.0,) * 2}[code[-5:]]  # fmt: skip
    phi, lam = np.radians(lat), np.radians(lon)
    radius = a * b / np.hypot(b * np.cos(phi), a * np.sin(phi)) + height
    expected = radius[:, None] * np.stack([np.cos(phi) * np.cos(lam), np.cos(phi) * np.sin(lam), np.sin(phi)], axis=1)
    got = points_on(code, np.stack([lon, lat, height], axis=1))
    assert np.abs(got - expected).max() < 1e-6
    assert np.isnan(points_on(code, np.full((1, 3), np.nan))).all()


@pytest.mark.oracle
def test_a_map_of_the_moon(rng: np.random.Generator) -> None:
    """Equirectangular easting and northing of the Moon are longitude and latitude times the radius."""
    lon, lat, height = rng.uniform(-2.0, 2.0, 20), rng.uniform(-1.0, 1.0, 20), rng.uniform(-900.0, 900.0, 20)
    got = points_on("IAU_2015:30110", np.stack([1737400.0 * lon, 1737400.0 * lat, height], axis=1))
    expected = ground_on(Body("Moon", (1737400.0,) * 3), np.degrees(lon), np.degrees(lat), height)
    assert np.abs(got - expected).max() < 1e-5


@pytest.mark.behaviour
@pytest.mark.parametrize("code", ["IAU_2015:49901", "IAU_2015:49912"])
def test_refused_codes_of_the_iau(code: str) -> None:
    """An IAU code with longitude positive to the west, or a map of an ellipsoid, is refused.

    PROJ uses planetographic latitudes for that map.
    """
    with pytest.raises(InputError) as caught:
        points_on(code, np.zeros((1, 3)))
    assert [p.code for p in caught.value.problems] == ["geodesy.body_axes"]


@pytest.mark.behaviour
def test_points_with_a_code_of_the_iau(tmp_path: Path) -> None:
    """Control points by an IAU code are those in body-fixed metres within 1e-6 m; codes of other bodies are refused."""
    names = write_block(tmp_path, n_points=14)
    block = fg.read_project(tmp_path / "project.toml")
    body, ids = block.images[0].sensor.body, block.points.ids
    known = [k for k, role in enumerate(block.points.roles) if role == "control"]
    xyz = block.points.known.ecef_m[known]
    head = "id,role,{},sigma_east_m,sigma_north_m,sigma_up_m\n"
    tables = {"body-fixed": ("x_m,y_m,z_m", xyz), "IAU_2015:30100": ("lon_deg,lat_deg,height_m", body.coordinates(xyz))}
    ground = []
    for crs, (columns, values) in tables.items():
        rows = [f"{ids[k]},control,{','.join(map(repr, row))},30.0,30.0,50.0"
                for k, row in zip(known, values.tolist(), strict=True)]  # fmt: skip
        rows += [f"{name},tie,,,,,," for k, name in enumerate(ids) if k not in known]
        (tmp_path / "points.csv").write_text(head.format(columns) + "\n".join(rows) + "\n")
        text = (tmp_path / "project.toml").read_text()
        begin, end = text.index("[points]"), text.index("[observations]")
        own = f'{text[:begin]}[points]\nfile = "points.csv"\ncrs = "{crs}"\n{text[end:]}'
        (tmp_path / "own.toml").write_text(own)
        read = fg.read_project(tmp_path / "own.toml")
        ground.append(read.points.known.ecef_m[[read.points.ids.index(ids[k]) for k in known]])
    assert names and np.abs(ground[0] - xyz).max() == 0.0 and np.abs(ground[1] - xyz).max() < 1e-6
    for crs, code in (("IAU_2015:49900", "body.crs"), ("EPSG:4979", "body.crs"), ("IAU_2015:12345", "body.unknown")):
        (tmp_path / "own.toml").write_text(own.replace("IAU_2015:30100", crs))
        with pytest.raises(InputError) as caught:
            fg.read_project(tmp_path / "own.toml")
        assert code in {p.code for p in caught.value.problems}, crs


@pytest.mark.behaviour
def test_result_on_the_moon(tmp_path: Path) -> None:
    """A result on the Moon names the body, its report has the Moon's kilometres, and exports in WGS 84 are refused."""
    write_block(tmp_path, n_points=20)
    out = tmp_path / "out"
    run = CliRunner().invoke(app, ["adjust", str(tmp_path / "project.toml"), "--out", str(out)])
    assert run.exit_code in (0, 4), run.output
    record = json.loads((out / "result.json").read_text())
    assert record["body"] == {"name": "Moon", "radii_m": [1e3 * RADIUS_KM] * 3}
    page = (out / "report.html").read_text()
    degree = float(re.search(r'"kmPerDegree":\s*\[[-\d.e]+,\s*([-\d.e]+)', page)[1])  # type: ignore[index]
    assert degree == pytest.approx(np.radians(RADIUS_KM), rel=1e-6)
    assert "WGS 84" not in re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)
    with pytest.raises(InputError, match="another body"):
        export(out, tmp_path / "points.geojson")
    with pytest.raises(InputError, match="another body"):
        fg.read_result(out).to_geo()


@pytest.mark.consistency
def test_commands_on_the_moon(tmp_path: Path) -> None:
    """``locate``, ``project`` and ``footprint`` use the radius of the Moon, and pixels return within 1e-6 px."""
    name = write_block(tmp_path, n_points=5)[0]
    isd = str(tmp_path / f"{name}.isd")
    runner = CliRunner()
    run = runner.invoke(app, ["locate", isd, "--json", "--line", "300", "--sample", "700", "--height", "250"])
    assert run.exit_code == 0, run.output
    (point,) = json.loads(run.stdout)["points"]
    assert np.linalg.norm([point[f"{axis}_m"] for axis in "xyz"]) == pytest.approx(1e3 * RADIUS_KM + 250.0, abs=1e-4)
    back = ["--lon", repr(point["lon_deg"]), "--lat", repr(point["lat_deg"]), "--height", "250"]
    run = runner.invoke(app, ["project", isd, "--json", *back])
    assert run.exit_code == 0, run.output
    (pixel,) = json.loads(run.stdout)["points"]
    assert (pixel["line"], pixel["sample"]) == pytest.approx((300.0, 700.0), abs=1e-6)
    run = runner.invoke(app, ["footprint", isd, "--height", "0", "--json"])
    assert run.exit_code == 0, run.output
    (image,) = json.loads(run.stdout)["images"]
    assert image["gsd_line_m"] == pytest.approx(0.02 / 76.054 * 105e3, rel=0.1)  # height by pixel over focal length
    assert image["area_km2"] == pytest.approx((2e-3 * image["gsd_line_m"] * 1e3) ** 2, rel=0.2)


@pytest.mark.consistency
def test_adjusted_image_as_state_by_the_command(tmp_path: Path) -> None:
    """``convert --result`` writes the adjusted projection centre to a state and to an ISD within 1e-6 m."""
    name, runner, out = write_block(tmp_path, n_points=12)[0], CliRunner(), tmp_path / "out"
    assert runner.invoke(app, ["adjust", str(tmp_path / "project.toml"), "--out", str(out)]).exit_code in (0, 4)
    image = fg.read_sensor(tmp_path / f"{name}.isd")
    eop = fg.read_result(out).tables["eop"]
    rows = [k for k, one in enumerate(eop.words["image"]) if one == name]
    expected = image.camera.corrected(eop.figures["value_per_tau"][rows])
    assert np.linalg.norm(expected.position_m - image.camera.position_m) > 1.0
    for form, file in (("csm-state", "x.json"), ("isd", "x.isd")):
        words = ["convert", str(tmp_path / f"{name}.isd"), "--to", form, "--out", str(tmp_path / file)]
        run = runner.invoke(app, [*words, "--result", str(out), "--image", name])
        assert run.exit_code == 0, run.output
        written = fg.read_sensor(tmp_path / file).camera
        assert np.abs(written.centre_m - expected.centre_m).max() < 1e-6
