"""The significance of camera parameters agrees with numpy and refits, including correlations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import f as fisher
from scipy.stats import t as student

from fg_orient.quality.camera import ImageCofactors, inseparable, multiple_correlation
from fg_orient.quality.significance import camera_significance
from tests.support.command import in_process as run

NAMES = ("c", "x0", "y0", "k1", "k2", "p1", "p2")


def scene(folder: Path, distance: float, noise: float = 0.002) -> list[str | Path]:
    """Return the tables of eight rolled photos on a ring around points of 6 m x 6 m x 4 m, from a distance (m)."""
    rng, focal = np.random.default_rng(3), 50.0
    grid = np.stack(np.meshgrid(np.arange(7.0), np.arange(7.0)), -1).reshape(-1, 2) - 3.0
    points = np.column_stack([grid, rng.uniform(-2.0, 2.0, 49)])
    rows, photos = [], []
    for k in range(8):
        around, off = np.pi / 4.0 * k, np.radians(40.0)
        at = distance * np.array([np.sin(off) * np.cos(around), np.sin(off) * np.sin(around), np.cos(off)])
        view = -at / distance
        right = np.cross([0.0, 1.0, 0.0], view)
        right /= np.linalg.norm(right)
        turn = Rotation.from_euler("z", 90 * k, degrees=True).as_matrix() @ [right, np.cross(view, right), view]
        seen = (points - at) @ turn.T
        image = focal * seen[:, :2] / seen[:, 2:] + rng.normal(0.0, noise, (49, 2))
        rows += [f"q{j},ph{k},{x!r},{y!r}" for j, (x, y) in enumerate(image.tolist())]
        photos.append(f'[[photos]]\nname = "ph{k}"\nfocal = {focal}\nprincipal = [0.0, 0.0]\ny_axis = "down"\n'
                      f"rotation = {turn.tolist()}\ncentre_m = {at.tolist()}\n")  # fmt: skip
    control = [f"q{j},{','.join(map(repr, points[j].tolist()))}" for j in (0, 6, 24, 42, 48)]
    for name, lines in (
        ("image.csv", ["id,photo,x,y", *rows]), ("control.csv", ["id,x_m,y_m,z_m", *control]),
        ("photos.toml", ["schema = 1", *photos]),
    ):  # fmt: skip
        (folder / name).write_text("\n".join(lines) + "\n", "utf-8")
    return ["closerange", "bundle", folder / "image.csv", folder / "photos.toml", "--control", folder / "control.csv",
            "--sigma", "0.002", "--json", "--shared", ",".join(NAMES)]  # fmt: skip


@pytest.mark.oracle
def test_multiple_correlation_is_the_share_of_the_variance_that_others_explain() -> None:
    """The multiple correlation follows from the conditional variance, and is that of a regression of drawn values."""
    rng = np.random.default_rng(1)
    a = rng.normal(size=(4, 4))
    q = a @ a.T
    conditional = q[0, 0] - q[0, 1:] @ np.linalg.inv(q[1:, 1:]) @ q[1:, 0]
    assert multiple_correlation(q) == pytest.approx(np.sqrt(1.0 - conditional / q[0, 0]), rel=1e-9)
    drawn = rng.normal(size=(200_000, 4)) @ a.T
    fitted = drawn[:, 1:] @ np.linalg.lstsq(drawn[:, 1:], drawn[:, 0], rcond=None)[0]
    # standard deviation of a correlation from n draws: below 1 / sqrt(n)
    assert abs(multiple_correlation(q) - np.corrcoef(fitted, drawn[:, 0])[0, 1]) <= 5.0 / np.sqrt(200_000)
    assert multiple_correlation(np.diag([0.0, 1.0, 1.0])) == 0.0


@pytest.mark.oracle
def test_t_and_f_by_numpy() -> None:
    rng = np.random.default_rng(2)
    a = rng.normal(size=(5, 5))
    q, x, m0, f = a @ a.T, rng.normal(size=5), 1.3, 12
    labels = [("camera all", name) for name in ("c", "k1", "k2", "p1", "p2")]
    found = camera_significance(labels, x, q, m0, f)
    t = np.abs(x[1:]) / (m0 * np.sqrt(np.diag(q)[1:]))
    assert [c.name for c in found.coefficients] == ["k1", "k2", "p1", "p2"]
    assert [c.probability for c in found.coefficients] == pytest.approx(2.0 * student.sf(t, f), rel=1e-9)
    for group, at in zip(found.groups, ([1, 2], [3, 4]), strict=True):
        statistic = x[at] @ np.linalg.inv(q[np.ix_(at, at)]) @ x[at] / 2.0 / m0**2
        assert group.statistic == pytest.approx(statistic, rel=1e-9)
        assert group.probability == pytest.approx(fisher.sf(statistic, 2, f), rel=1e-9)


@pytest.mark.oracle
@pytest.mark.parametrize(("distance", "warned"), [(8.0, False), (60.0, True)])
def test_far_photos_do_not_separate_principal_distance_and_distance(
    tmp_path: Path, distance: float, warned: bool
) -> None:
    """Photos from 60 m give a warning that c and distance are inseparable; photos from 8 m do not.

    From 60 m the points fill only 6 degrees, and perspective is weak.
    """
    done = run(*scene(tmp_path, distance))
    assert done.code == 0, done.stderr
    codes = {f["code"]: f for f in done.json["findings"]}
    assert ("camera.distance" in codes) is warned and "camera.decentring" not in codes
    if warned:
        (which,) = codes["camera.distance"]["data"]["which"]
        assert which.startswith("c of camera all (0.9") and "hold the principal distance" in done.json["warnings"][0]


@pytest.mark.oracle
def test_f_is_what_the_removal_of_parameters_costs(tmp_path: Path) -> None:
    """F of decentring is (v^T P v without - with) / (d m0^2), from an adjustment without these parameters."""
    words = scene(tmp_path, 8.0, noise=2e-5)  # second-order terms are a share of the noise: 1e-3 at 2 um
    full = run(*words).json
    rest = run(*words[:-1], ",".join(NAMES[:5])).json
    group = next(g for g in full["significance"]["groups"] if g["group"].startswith("decentring"))
    squares = full["m0"] ** 2 * full["redundancy"], rest["m0"] ** 2 * rest["redundancy"]
    assert rest["redundancy"] - full["redundancy"] == group["dimension"] == 2
    assert group["statistic"] == pytest.approx((squares[1] - squares[0]) / 2.0 / full["m0"] ** 2, rel=1e-3)


@pytest.mark.behaviour
def test_each_camera_is_named_and_fixed_centres_have_no_distance() -> None:
    """x0 and p1 of two cameras are inseparable; c and the distance are only if the centre is not fixed."""
    q = np.eye(5)
    q[[0, 1, 3, 4], [1, 0, 4, 3]] = 0.99  # x0 and p1, c and Z0
    names, fixed, free = ("x0", "p1", "p2", "c", "Z0"), np.zeros(5), np.array([0.0, 0.0, 0.0, 0.0, 1.0])
    cameras = [ImageCofactors(f"camera {k}", names, qk, fixed) for k, qk in (("a", q), ("b", np.eye(5)), ("d", q))]
    (found,) = inseparable(cameras)
    assert found.code == "camera.decentring"
    assert found.data["which"] == ["x0 of camera a (0.990)", "x0 of camera d (0.990)"]
    codes = {found.code for found in inseparable([ImageCofactors("camera a", names, q, free)])}
    assert codes == {"camera.decentring", "camera.distance"}
