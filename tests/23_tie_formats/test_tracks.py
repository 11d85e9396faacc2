"""Matches are joined to tie points as by a written-out union-find; conflicts are counted; 1e5 rows are arrays."""

from __future__ import annotations

import numpy as np
import pytest

from fg_orient.formats.exchange.ties import conflict_note, join
from tests.support.work import counted


def union_find(n: int, matches: list[tuple[int, int]]) -> dict[int, set[int]]:
    """Return the sets of matched keypoints by their smallest member, one union after the other."""
    parent = list(range(n))

    def root(a: int) -> int:
        while parent[a] != a:
            a = parent[a]
        return a

    for a, b in matches:
        parent[root(b)] = root(a)
    sets: dict[int, set[int]] = {}
    for k in {k for pair in matches for k in pair}:
        sets.setdefault(root(k), set()).add(k)
    return {min(members): members for members in sets.values()}


def members(tracks: tuple[np.ndarray, np.ndarray]) -> list[set[int]]:
    keypoint, track = tracks
    return [set(keypoint[track == k].tolist()) for k in range(number(tracks))]


def number(tracks: tuple[np.ndarray, np.ndarray]) -> int:
    return len(set(tracks[1].tolist()))


@pytest.mark.oracle
def test_tracks_are_those_of_a_union_find_and_chains_with_two_places_of_an_image_are_out() -> None:
    n_conflicts = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        image = rng.integers(0, 5, 60)
        line, sample = rng.permutation(60).astype(float), rng.permutation(60).astype(float)
        pairs = [(int(a), int(b)) for a, b in rng.integers(0, 60, (25, 2)) if image[a] != image[b]]
        found, out = join(image, line, sample, np.array(pairs))
        sets = union_find(60, pairs)
        single = {first: s for first, s in sets.items() if len({image[k] for k in s}) == len(s)}
        assert members(found) == [single[first] for first in sorted(single)]
        assert number(out) == len(sets) - len(single)
        n_conflicts += number(out)
        assert set(out[0].tolist()) == set().union(*(s for f, s in sets.items() if f not in single))
    assert n_conflicts > 20


@pytest.mark.behaviour
def test_keypoints_at_one_pixel_of_one_image_are_one() -> None:
    image = np.array([0, 0, 1, 2])
    line, sample = np.array([5.0, 5.0, 1.0, 2.0]), np.array([7.0, 7.0, 3.0, 4.0])
    found, _ = join(image, line, sample, np.array([[0, 2], [1, 3]]))
    assert members(found) == [{0, 2, 3}]
    apart, _ = join(image, line + np.array([0.0, 1e-9, 0.0, 0.0]), sample, np.array([[0, 2], [1, 3]]))
    assert members(apart) == [{0, 2}, {1, 3}]


@pytest.mark.behaviour
def test_a_conflict_is_told_with_its_image_and_places() -> None:
    image = np.array([0, 1, 2, 0, 0, 1])
    line, sample = np.array([1.5, 2, 3, 4, 8, 9]), np.array([10.0, 20, 30, 40, 80, 90])
    found, out = join(image, line, sample, np.array([[0, 1], [1, 2], [2, 3], [4, 5]]))
    assert members(found) == [{4, 5}]
    (told,) = conflict_note(number(found), out, ["a", "b", "c"], image, line, sample)
    assert str(told) == (
        "1 of 2 tie points left out (4 image points): their matches connect two different pixels of one image, the"
        " first (1.5, 10) and (4, 40) of a"
    )
    good, none = join(image, line, sample, np.array([[4, 5]]))
    assert conflict_note(number(good), none, ["a", "b", "c"], image, line, sample) == ()


@pytest.mark.behaviour
def test_nothing_matched_is_no_tie_point() -> None:
    found, out = join(np.array([0, 1]), np.zeros(2), np.zeros(2), np.empty((0, 2)))
    assert (number(found), len(found[0]), number(out)) == (0, 0, 0)
    assert number(join(np.array([], int), np.array([]), np.array([]), np.empty((0, 2)))[0]) == 0


@pytest.mark.behaviour
@pytest.mark.parametrize(("matches", "words"), [([[0, 2]], "does not exist"), ([[0, 1]], "one image")])
def test_impossible_matches_are_refused(matches: list[list[int]], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        join(np.zeros(2, int), np.arange(2.0), np.arange(2.0), np.array(matches))


@pytest.mark.behaviour
def test_a_hundred_thousand_matches_are_joined_as_arrays() -> None:
    """Joining 100 000 matches makes as many function calls as joining a thousand, below 2000."""
    joined(50)  # imports, caches
    assert joined(50_000) == joined(500) < 2000


def joined(n: int) -> int:
    """Join points of three images; return the number of function calls."""
    rng = np.random.default_rng(3)
    image, point = np.repeat(np.arange(3), n), np.tile(np.arange(n), 3)
    pair = np.column_stack([np.arange(n), np.arange(n) + n])
    matches = np.concatenate([pair, pair + n])
    line, sample = rng.uniform(0.0, 1e4, (2, 3 * n))
    with counted() as calls:
        found, out = join(image, line, sample, matches)
    assert (number(found), number(out)) == (n, 0)
    assert np.array_equal(point[found[0]], found[1])
    return calls.count
