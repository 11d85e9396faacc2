"""Adjustment of a synthetic block in memory, in about a second, to see that the installation computes.

The observations of the Zonguldak twin are free of errors here. Its metadata are wrong by constants, which an
adjustment without priors recovers. A sound installation finds the check points to a micrometre; a wrong Jacobian, a
broken compiler cache or a foreign GTSAM does not.
"""

from __future__ import annotations

from typing import Final

import numpy as np

#: Largest error of the check points: rounding of ECEF coordinates is 1e-9 m, one step leaves 1e-7 m.
TOLERANCE_M: Final = 1e-6


def self_test() -> tuple[bool, str]:
    """Adjust the synthetic block.

    Returns
    -------
    good : bool
        The coordinates of the check points are right within a micrometre.
    detail : str
        Iterations and largest error, in words.
    """
    from fg_orient.orientation.orient import adjust
    from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block

    exact = ZonguldakOptions(image_noise_px=0.0, ground_noise_m=(0.0, 0.0, 0.0))
    solution = adjust(zonguldak_block(exact)[0], eop_set="PUA0", priors=False)
    error = float(np.abs(solution.accuracy.check.ecef_m).max())
    good = solution.status == "converged" and error < TOLERANCE_M
    return good, f"{solution.status} after {solution.iterations} iterations, check points within {error:.1e} m"
