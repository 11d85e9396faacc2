"""The loop of rejection is tested alone, on means of a few numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from fg_orient.quality.rejection import Change, Rejection, reject

pytestmark = pytest.mark.behaviour

VALUES = np.array([1.0, 1.1, 0.9, 1.05, 9.0, 0.95, -5.0])
#: Distance from the mean of the others beyond which a value is suspicious.
FAR = 2.0


def mean(out: Sequence[int], _: float = np.nan) -> float:
    return float(np.delete(VALUES, out).mean())


def worst(fit: float, out: Sequence[int]) -> list[int]:
    distance = np.abs(VALUES - fit)
    distance[list(out)] = 0.0
    return [int(distance.argmax())] if distance.max() > FAR else []


def both(fit: float, out: Sequence[int]) -> list[int]:
    """Return the two values far from the median that are not yet out; the mean hides one of them."""
    return [k for k in (4, 6) if k not in out]


def rejected(most: int = 5, fit: Callable[[Sequence[int], float], float] = mean, **more: object) -> Rejection:
    return reject(mean([]), fit, worst, most, **more)  # type: ignore[arg-type]


def test_the_worst_goes_first_and_each_fit_is_without_what_is_out() -> None:
    found = rejected()
    assert found.out == (4, 6)
    assert found.changes == (Change(left_out=(4,)), Change(left_out=(6,)), Change())
    assert found.fit == mean([4, 6])
    assert found.worst is None and found.error is None


@pytest.mark.parametrize("most", [0, 1])
def test_no_more_than_allowed_go(most: int) -> None:
    found = rejected(most)
    assert found.out == (4, 6)[:most]
    assert found.worst == (4, 6)[most] and found.error is None
    assert found.fit == mean(found.out)


def test_what_fits_comes_back_before_anything_goes_and_once_only() -> None:
    asked: list[tuple[int, ...]] = []

    def returning(_: float, out: Sequence[int], may: Sequence[int]) -> list[int]:
        asked.append(tuple(out))
        return list(may) if len(out) == 2 else []

    found = rejected(returning=returning)
    assert asked == [(), (4,), (4, 6), (), (4,), (4, 6)]
    assert found.changes == (
        Change(left_out=(4,)), Change(left_out=(6,)), Change(put_back=(4, 6)), Change(left_out=(4,)),
        Change(left_out=(6,)), Change(),
    )  # fmt: skip
    assert found.out == (4, 6)


def test_the_last_one_is_taken_back_where_the_others_determine_no_fit() -> None:
    def fit(out: Sequence[int], _: float) -> float:
        if 6 in out:
            raise ArithmeticError("too few")
        return mean(out)

    found = rejected(fit=fit, impossible=(ArithmeticError,))
    assert found.out == (4,) and found.worst == 6
    assert str(found.error) == "too few"
    assert found.changes == (Change(left_out=(4,)), Change())
    assert found.fit == mean([4])
    with pytest.raises(ArithmeticError):
        rejected(fit=fit)


def test_several_go_in_one_round_and_one_of_them_where_the_others_determine_no_fit() -> None:
    found = reject(mean([]), mean, both, 5)
    assert found.changes == (Change(left_out=(4, 6)), Change())
    assert found.out == (4, 6) and found.fit == mean([4, 6]) and found.worst is None
    assert reject(mean([]), mean, both, 1).changes == (Change(left_out=(4,)), Change())

    def fit(out: Sequence[int], _: float) -> float:
        if len(out) == 2:
            raise ArithmeticError("too few")
        return mean(out)

    found = reject(mean([]), fit, both, 5, impossible=(ArithmeticError,))
    assert found.changes == (Change(left_out=(4,)), Change())
    assert found.out == (4,) and found.worst == 6 and str(found.error) == "too few"
    found = reject(mean([]), fit, lambda f, out: both(f, out) if out else [4], 5, impossible=(ArithmeticError,))
    assert found.out == (4,) and found.worst == 6


def test_half_of_several_go_until_the_others_determine_a_fit() -> None:
    tried: list[tuple[int, ...]] = []

    def fit(out: Sequence[int], _: float) -> float:
        tried.append(tuple(out))
        if 2 in out:
            raise ArithmeticError("too few")
        return mean(out)

    def all_of_them(_: float, out: Sequence[int]) -> list[int]:
        return [k for k in (4, 6, 2, 3, 1) if k not in out]

    found = reject(mean([]), fit, all_of_them, 5, impossible=(ArithmeticError,))
    assert tried == [(4, 6, 2, 3, 1), (4, 6), (4, 6, 2, 3, 1), (4, 6, 2)]
    assert found.changes == (Change(left_out=(4, 6)), Change())
    assert found.out == (4, 6) and found.worst == 2 and str(found.error) == "too few"


def test_a_fit_that_fails_with_more_observations_is_an_error() -> None:
    calls = 0

    def fit(out: Sequence[int], _: float) -> float:
        nonlocal calls
        calls += 1
        if calls == 2:
            raise ArithmeticError("not that")
        return mean(out)

    with pytest.raises(ArithmeticError, match="not that"):
        rejected(fit=fit, impossible=(ArithmeticError,), returning=lambda _, out, may: may)
