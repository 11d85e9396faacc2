"""Levenberg-Marquardt solves equations that are singular without damping, as in a free network."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from fg_orient.adjustment.loop import ROUNDING_STEP, Backend, dogleg, gauss_newton, levenberg_marquardt

TRUE_LENGTH = 3.0


class Distance(Backend):
    """A distance between two points of the plane, exact and one of three unknown turns or shifts free."""

    def residuals(self, x: np.ndarray) -> np.ndarray:
        return np.array([np.hypot(*(x[2:] - x[:2])) - TRUE_LENGTH])

    def linearise(self, state: np.ndarray) -> SimpleNamespace:
        unit = (state[2:] - state[:2]) / np.hypot(*(state[2:] - state[:2]))
        jacobian, r = np.concatenate([-unit, unit])[None], self.residuals(state)

        def solve(damping: float) -> SimpleNamespace:
            if damping < 1e-6:  # what rounding leaves of a pivot that is zero may have either sign
                raise RuntimeError("the normal equations are singular")
            x = -np.linalg.solve(jacobian.T @ jacobian + damping * np.eye(4), jacobian.T @ r)
            after = r + jacobian @ x
            return SimpleNamespace(length=np.abs(x).max(), predicted_error=0.5 * float(after @ after), data=x)

        return SimpleNamespace(error=self.error(state), solve=solve, dogleg=lambda radius: solve(0.0))

    def error(self, state: np.ndarray) -> float:
        return 0.5 * float(self.residuals(state) @ self.residuals(state))

    def retract(self, state: np.ndarray, step: SimpleNamespace) -> np.ndarray:
        return state + step.data


@pytest.mark.truth
def test_damping_makes_them_regular_and_the_loop_ends() -> None:
    result = levenberg_marquardt(Distance(), np.array([0.0, 0.0, 7.0, 1.0]), 60)
    assert result.converged, result.reason
    assert abs(Distance().residuals(result.state)[0]) < ROUNDING_STEP
    singular = [r for r in result.log if np.isinf(r.step)]
    assert singular and not any(r.accepted for r in singular)
    assert len(result.log) < 20


@pytest.mark.behaviour
@pytest.mark.parametrize("optimizer", [gauss_newton, dogleg])
def test_without_damping_they_are_an_error(optimizer) -> None:
    with pytest.raises(RuntimeError, match="singular"):
        optimizer(Distance(), np.array([0.0, 0.0, 7.0, 1.0]), 60)
