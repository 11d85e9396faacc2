"""The eight point sets have the stated sizes and shapes."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from fg_orient.model.names import Role
from fg_orient.simulate.zonguldak import CHECK_COUNT, N_POINTS, roles_of


@pytest.fixture
def pixels(rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(0.0, 12000.0, (N_POINTS, 2))


def split(point_set: str, pixels: np.ndarray, seed: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices of control and of check points."""
    roles = roles_of(point_set, pixels, np.random.default_rng(seed))
    return tuple(np.array([k for k, r in enumerate(roles) if r is role], int) for role in (Role.CONTROL, Role.CHECK))


@pytest.mark.truth
def test_published_sizes(pixels: np.ndarray) -> None:
    counts = {"H-0": 0, "H-10": 10, "H-20": 20, "H-30": 30, "H-40": 40, "G-A": 24, "G-B": 23, "G-C": 30}
    assert counts == CHECK_COUNT
    for name, count in counts.items():
        control, check = split(name, pixels)
        assert (len(control), len(check)) == (47 - count, count), name


@pytest.mark.behaviour
def test_homogeneous_sets_are_nested_and_drawn_by_the_seed(pixels: np.ndarray) -> None:
    sets = [set(split(f"H-{n}", pixels)[1].tolist()) for n in (10, 20, 30, 40)]
    assert all(a < b for a, b in itertools.pairwise(sets))
    assert sets[0] != set(split("H-10", pixels, seed=5)[1].tolist())


@pytest.mark.behaviour
@pytest.mark.parametrize(("name", "axis"), [("G-A", 1), ("G-B", 0)])
def test_grouped_sets_leave_one_side_without_control(name: str, axis: int, pixels: np.ndarray) -> None:
    sides = set()
    for seed in range(8):
        control, check = (pixels[rows, axis] for rows in split(name, pixels, seed))
        below, above = control.max() < check.min(), control.min() > check.max()
        assert below != above
        sides.add(bool(below))
    assert sides == {True, False}, "the side is drawn"


@pytest.mark.behaviour
def test_central_set(pixels: np.ndarray) -> None:
    control, check = split("G-C", pixels)
    distance = np.linalg.norm(pixels - pixels.mean(axis=0), axis=1)
    assert distance[control].max() < distance[check].min()
