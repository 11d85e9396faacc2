"""Add jitter curves to the unknowns of a pushbroom image."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from factors.geometry import polynomials
from fg_orient.model.jitter import JitterCurve
from fg_orient.model.names import COMPONENTS
from fg_orient.model.parameters import CURVE, CURVES, ImageParameters, parameter_name, parameter_words


def with_jitter(parameters: ImageParameters, curves: Sequence[JitterCurve]) -> ImageParameters:
    """Return the unknowns of a pushbroom image with its jitter curves.

    The degree-2 coefficients of an angle also represent the quadratic part of its jitter.
    The prior variance of that part is therefore added to theirs.
    """
    sigma, codes, of_codes = parameters.sigma.copy(), list[int](), list[float]()
    for curve in curves:
        component = COMPONENTS.index(curve.angle)
        for degree, unit in enumerate(polynomials.jitter_quadratic(curve.intervals).tolist()):
            if 3 * component + degree in parameters.codes:
                at = parameters.codes.index(3 * component + degree)
                sigma[at] = np.hypot(sigma[at], unit * curve.sigma_rad)
        codes += [CURVE + CURVES * component + k for k in range(curve.intervals)]
        of_codes += [curve.sigma_rad] * curve.intervals
    return ImageParameters(
        (*parameters.codes, *codes),
        np.concatenate([sigma, of_codes]),
        (*parameters.names, *map(parameter_name, codes)),
        (*parameters.units, *("rad" for _ in codes)),
        (*parameters.words, *map(parameter_words, codes)),
        (*parameters.shared, *("" for _ in codes)) if parameters.shared else (),
    )
