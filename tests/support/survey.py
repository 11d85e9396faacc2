"""The module makes random surveys for the formats of other programs and compares two surveys."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fg_orient.formats.exchange.survey import Survey, no_image_points
from fg_orient.formats.registry import Format, Holds
from fg_orient.model.block import ImagePoints
from fg_orient.model.names import Role

#: Middle of the coordinates and their spread, by CRS: inside the area of use of each.
PLACES = {
    "EPSG:4979": ((31.8, 41.4, 300.0), (0.3, 0.2, 400.0)),
    "EPSG:32636": ((400e3, 4580e3, 300.0), (2e4, 2e4, 400.0)),
    "EPSG:5254": ((580e3, 4580e3, 300.0), (2e4, 2e4, 400.0)),  # its definition puts northing first
}
#: Names as people give them; some formats know words without blanks only.
NAMES = ("01", "1", "GCP 7", "Kule Çatı", "=SUM(A1)", "a,b", 'the "old" one', "-5", "Iğdır ılıca")
PLAIN = ("01", "1", "GCP_7", "Çatı", "=SUM(A1)", "-5", "Iğdır", "p.8", "x/9")


def random_survey(rng: np.random.Generator, format_: Format, crs: str = "EPSG:32636", *, plain: bool = False) -> Survey:
    """Return a survey that has all that a format can hold, and nothing that it cannot."""
    holds, n = format_.holds, int(rng.integers(3, 8))
    ids = tuple(rng.permutation(PLAIN if plain else NAMES)[:n].tolist())
    roles = [Role.CONTROL] * n
    if Holds.IDS not in holds:
        ids = tuple(map(str, range(1, n + 1)))
    if Holds.ROLES in holds:
        roles[1] = Role.CHECK
    if Holds.TIES in holds:
        roles[2] = Role.TIE
    known = np.array([role is not Role.TIE for role in roles])
    middle, spread = PLACES[crs]
    coordinates = np.where(known[:, None], rng.uniform(-1.0, 1.0, (n, 3)) * spread + middle, np.nan)
    if Holds.HEIGHTS not in holds:
        coordinates[:, 2] = np.nan
    fixed = np.zeros(n, bool)
    fixed[0] = Holds.FIXED in holds
    sigma = np.where((known & ~fixed)[:, None], _sigmas(rng, n, holds), np.nan)
    images, observed = _measured(rng, n, holds, plain)
    return Survey(
        crs if Holds.CRS in holds or Holds.GROUND in holds else "", ids, tuple(roles), coordinates, sigma, fixed,
        images, observed,
    )  # fmt: skip


def _sigmas(rng: np.random.Generator, n: int, holds: frozenset[Holds]) -> np.ndarray:
    sigma = rng.uniform(0.02, 2.0, (n, 3))
    if Holds.SIGMA_GROUND not in holds:
        return np.full((n, 3), np.nan)
    if Holds.SIGMA_EAST_NORTH not in holds:
        sigma[:, 1] = sigma[:, 0]
    if Holds.SIGMA_UP not in holds:
        sigma[:, 2] = sigma[:, 0]
    return sigma


def _measured(
    rng: np.random.Generator, n: int, holds: frozenset[Holds], plain: bool
) -> tuple[tuple[str, ...], ImagePoints]:
    if Holds.IMAGE not in holds:
        return (), no_image_points()
    if Holds.IMAGES not in holds:
        return ("left.tif",), ImagePoints(
            np.zeros(n, int), np.arange(n), *rng.uniform(-0.5, 11999.5, (2, n)), *np.full((2, n), np.nan)
        )
    images = ("left.tif", "right.tif") if plain else ("left image.tif", "sağ,2.tif")
    image, point = np.repeat([0, 1], n), np.tile(np.arange(n), 2)
    line, sample = rng.uniform(-0.5, 11999.5, (2, 2 * n))
    sigma = rng.uniform(0.1, 1.0, (2, 2 * n)) if Holds.SIGMA_IMAGE in holds else np.full((2, 2 * n), np.nan)
    return images, ImagePoints(image, point, line, sample, *sigma)


def taken(survey: Survey, rows: tuple[int, ...]) -> Survey:
    """Return the survey with some of the ground points, and the image points of these only."""
    k, o = list(rows), survey.observed
    o = o.take(np.isin(o.point, k))
    observed = ImagePoints(o.image, np.searchsorted(k, o.point), o.line, o.sample, o.sigma_line_px, o.sigma_sample_px)
    return replace(
        survey, ids=tuple(survey.ids[j] for j in k), roles=tuple(survey.roles[j] for j in k), lines=survey.lines[k],
        coordinates=survey.coordinates[k], sigma_enu_m=survey.sigma_enu_m[k], fixed=survey.fixed[k], observed=observed,
    )  # fmt: skip


def by_name(survey: Survey) -> dict[tuple[str, str], tuple[float, ...]]:
    """Return the image points by image and id: order is no information."""
    o = survey.observed
    return {
        (survey.images[i], survey.ids[p]): values
        for i, p, *values in zip(o.image, o.point, o.line, o.sample, o.sigma_line_px, o.sigma_sample_px, strict=True)
    }


def assert_same(found: Survey, expected: Survey, *, pixels: float = 0.0, sigmas: float = 0.0) -> None:
    """Assert that two surveys hold the same.

    Pixels and sigmas may differ by rounding where a reader adds or divides.
    """
    assert sorted(found.ids) == sorted(expected.ids)
    order = [found.ids.index(name) for name in expected.ids]
    assert [found.roles[k] for k in order] == list(expected.roles)
    np.testing.assert_array_equal(found.coordinates[order], expected.coordinates)
    np.testing.assert_allclose(found.sigma_enu_m[order], expected.sigma_enu_m, rtol=sigmas, atol=0.0)
    np.testing.assert_array_equal(found.fixed[order], expected.fixed)
    assert found.crs == expected.crs
    ours, theirs = by_name(found), by_name(expected)
    assert ours.keys() == theirs.keys()
    for key, values in theirs.items():
        np.testing.assert_allclose(ours[key], values, rtol=0.0, atol=pixels)


def without(survey: Survey, *words: str) -> Survey:
    """Return the survey without some of its fields, for what is lost."""
    return replace(survey, **{word: getattr(no_survey(len(survey.ids)), word) for word in words})


def no_survey(n: int) -> Survey:
    """Return the points of which only the number is known."""
    nothing = np.full((n, 3), np.nan)
    return Survey("", tuple(map(str, range(n))), (Role.CONTROL,) * n, nothing, nothing, np.zeros(n, bool))
