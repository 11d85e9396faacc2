"""Cofactors belong to the solution and its weights, as derivatives of independent functions show."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fg_orient.closerange.bundle import BundlePhoto, adjust_bundle
from fg_orient.closerange.dlt import fit_dlt
from fg_orient.closerange.intersection import intersect_photos
from fg_orient.closerange.orientation import RelativeOrientation, absolute_orientation, relative_orientation
from fg_orient.closerange.photo import Photo, PhotoInterior, rotation_from_ayhan
from fg_orient.closerange.resection import resect

from .conftest import Array

#: Noise by the size of the images (2 %): start values are off by as much, and so would cofactors there be.
NOISE = 0.3
CAMERA = PhotoInterior(60.0)
CENTRES = np.array([[0.0, 0.0, 0.0], [2.0, 0.3, 0.2], [-1.5, 0.4, 1.0]])


def turned(vector: Array, rotation: Array) -> Array:
    """Return a camera turned about its own axes."""
    return np.asarray(Rotation.from_rotvec(vector).as_matrix() @ rotation)


def cofactors(function: Callable[[Array], Array], n: int) -> Array:
    """Return the inverse normal matrix of weighted residuals by central differences at zero."""
    h = 1e-6
    slopes = [(function(h * e) - function(-h * e)).ravel() / (2.0 * h) for e in np.eye(n)]
    return np.asarray(np.linalg.inv(np.array(slopes) @ np.array(slopes).T))


def scene(seed: int, n: int = 10) -> tuple[list[Array], Array, np.random.Generator]:
    rng = np.random.default_rng(seed)
    rotations = [rotation_from_ayhan(*rng.normal(scale=0.1, size=3)) for _ in CENTRES]
    return rotations, np.array([0.5, 5.0, 0.0]) + rng.uniform(-1.0, 1.0, (n, 3)), rng


def alike(found: Array, expected: Array, tolerance: float = 1e-4) -> bool:
    """Return whether values are equal within their own standard deviations."""
    sd = np.sqrt(np.diag(expected))
    return bool(np.abs((found - expected) / np.outer(sd, sd)).max() <= tolerance)


def pair_distances(
    cameras: tuple[PhotoInterior, PhotoInterior],
    images: tuple[Array, Array],
    sigma: float,
    rotation: Array,
    base: Array,
) -> Array:
    """Return the triple products of base and rays over their standard deviations.

    These are propagated in the unit of the images.
    """

    def product(both: Array) -> Array:
        rays = [np.column_stack([c.tangents(xy), np.ones(len(xy))]) for c, xy in
                zip(cameras, (both[:, :2], both[:, 2:]), strict=True)]  # fmt: skip
        return np.asarray(np.cross(base, rays[0]) @ rotation.T * rays[1]).sum(axis=1)

    both, h = np.column_stack(images), 1e-4
    slopes = [(product(both + h * e) - product(both - h * e)) / (2.0 * h) for e in np.eye(4)]
    return np.asarray(product(both) / (sigma * np.linalg.norm(slopes, axis=0)))


@pytest.mark.oracle
@pytest.mark.parametrize("n", [7, 12])
def test_relative_orientation_of_two_cameras(n: int) -> None:
    """Distances and cofactors of a relative orientation equal those of an independent function.

    The cameras have 30 and 150 mm; with 7 points the starts are normal cases, 0.3 rad away.
    """
    rotations, points, rng = scene(1, n)
    cameras, sigma = (PhotoInterior(30.0), PhotoInterior(150.0)), 0.002
    second = turned(np.array([0.2, -0.3, 0.1]), rotations[0])
    images = tuple(
        Photo.of("", c, r, at).project(points) + rng.normal(scale=sigma, size=(n, 2))
        for c, r, at in zip(cameras, (rotations[0], second), CENTRES[:2], strict=True)
    )
    found: RelativeOrientation = relative_orientation(*cameras, images[0], images[1], sigma=sigma)
    shown = pair_distances(cameras, (images[0], images[1]), sigma, found.rotation, found.base)
    assert np.abs(shown) == pytest.approx(np.abs(found.distances), rel=1e-3, abs=1e-4)

    def moved(x: Array) -> Array:
        base = found.base + x[3:] @ found.base_axes
        return pair_distances(cameras, (images[0], images[1]), sigma, turned(x[:3], found.rotation), base)

    assert alike(found.cofactors, cofactors(moved, 5), 1e-2)  # distances to first order


@pytest.mark.oracle
def test_resection() -> None:
    rotations, points, rng = scene(2)
    image = Photo.of("", CAMERA, rotations[0], CENTRES[0]).project(points) + rng.normal(scale=NOISE, size=(10, 2))
    found = resect(CAMERA, points, image, sigma=NOISE)

    def moved(x: Array) -> Array:
        photo = Photo.of("", CAMERA, turned(x[:3], found.rotation), found.photo.origin_m + x[3:])
        return (photo.project(points) - image) / NOISE

    assert alike(found.cofactors, cofactors(moved, 6))


@pytest.mark.oracle
def test_dlt() -> None:
    rotations, points, rng = scene(3, 14)
    image = Photo.of("", CAMERA, rotations[0], CENTRES[0]).project(points) + rng.normal(scale=NOISE, size=(14, 2))
    found = fit_dlt(points, image, sigma=NOISE)

    def moved(x: Array) -> Array:
        p = np.append(found.values * (1.0 + x), 1.0).reshape(3, 4)
        q = (points - found.photo.origin_m) @ p[:, :3].T + p[:, 3]
        return (q[:, :2] / q[:, 2:] - image) / NOISE

    assert alike(found.cofactors / np.outer(found.values, found.values), cofactors(moved, 11))


@pytest.mark.oracle
def test_intersection() -> None:
    rotations, points, rng = scene(4, 6)
    photos = [Photo.of("", CAMERA, r, at) for r, at in zip(rotations, CENTRES, strict=True)]
    images = [p.project(points) + rng.normal(scale=NOISE, size=(6, 2)) for p in photos]
    found = intersect_photos(
        photos, np.repeat(np.arange(3), 6), np.tile(np.arange(6), 3), np.vstack(images), sigma=NOISE
    )
    for k, (point, own) in enumerate(zip(found.points_m, found.cofactors, strict=True)):

        def moved(x: Array, k: int = k, point: Array = point) -> Array:
            seen = [p.project(point + x)[0] - image[k] for p, image in zip(photos, images, strict=True)]
            return np.array(seen) / NOISE

        assert alike(own, cofactors(moved, 3))


@pytest.mark.oracle
def test_absolute_orientation() -> None:
    """Cofactors of an absolute orientation equal those of an independent function with unequal sigmas.

    The start is the solution for equal sigmas.
    """
    _, model, rng = scene(5)
    turn = Rotation.from_rotvec([0.5, -1.0, 0.3]).as_matrix()
    sigma = np.exp(rng.uniform(-2.0, 1.0, model.shape)) * 0.3
    ground = np.array([3.0, 4.0, 5.0]) + 2.0 * model @ turn.T + rng.normal(size=model.shape) * sigma
    found = absolute_orientation(model, ground, sigma_m=sigma)

    def moved(x: Array) -> Array:
        rotation = turned(x[:3], found.rotation)
        return (found.shift_m + x[4:] + found.scale * np.exp(x[3]) * model @ rotation.T - ground) / sigma

    assert alike(found.cofactors, cofactors(moved, 7))


@pytest.mark.oracle
@pytest.mark.parametrize("backend", ["dense", "graph", "schur"])
def test_bundle(backend: str) -> None:
    """Cofactors of new points equal those of an independent function, and do not depend on the start.

    There are three photos and six new points.
    """
    rotations, points, rng = scene(6)
    which, of = np.repeat(np.arange(3), 10), np.tile(np.arange(10), 3)
    image = np.vstack([Photo.of("", CAMERA, r, c).project(points) for r, c in zip(rotations, CENTRES, strict=True)])
    image = image + rng.normal(scale=NOISE, size=image.shape)
    ids, start = [f"p{k}" for k in range(10)], points + rng.normal(scale=0.1, size=points.shape)
    start[:4] = points[:4]
    first = [BundlePhoto(str(k), CAMERA, r, c + 0.1) for k, (r, c) in enumerate(zip(rotations, CENTRES, strict=True))]
    control = {name: (at, 0.0) for name, at in zip(ids[:4], points, strict=False)}
    found = adjust_bundle(first, ids, start, which, of, image, sigma=NOISE, control=control, backend=backend)
    second = [BundlePhoto(p.name, CAMERA, r, c) for p, r, c in
              zip(first, found.rotations, found.centres_m, strict=True)]  # fmt: skip
    again = adjust_bundle(
        second, ids, found.points_m, which, of, image, sigma=NOISE, control=control, backend=backend,
    )  # fmt: skip
    assert found.sigma_m is not None and again.sigma_m is not None
    assert found.sigma_m == pytest.approx(again.sigma_m, rel=1e-7)

    def moved(x: Array) -> Array:
        at = found.points_m + np.vstack([np.zeros((4, 3)), x[18:].reshape(6, 3)])
        photos = [
            Photo.of(
                "", CAMERA, turned(x[6 * k : 6 * k + 3], found.rotations[k]), found.centres_m[k] + x[6 * k + 3 :][:3]
            )
            for k in range(3)
        ]
        return (np.vstack([photo.project(at) for photo in photos]) - image) / NOISE

    own = cofactors(moved, 36)[18:, 18:]
    for k in range(6):
        part = slice(3 * k, 3 * k + 3)
        assert alike(found.point_cofactors[4 + k], own[part, part])
