"""Messages about the estimation of rational function models."""

from __future__ import annotations

from typing import Final

from fg_orient.model.messages.entry import words

WORDS: Final = words("""
rfm.points: control points need finite lines and samples (n,) and ground coordinates (n, 3)
    -> give one row per point; ground: longitude, latitude (degrees), height (m)
rfm.flat: all points have the same value of this coordinate: it cannot be normalised, nor its coefficients found
    -> measure points that differ in it, or take a lower degree without it
rfm.degree: the degree of a rational function model is 1, 2 or 3
    -> give one of them
rfm.denominators: no such denominators
    -> choose one of {known}
rfm.kept: the coefficients kept must be ascending numbers of unknowns of the form
    -> see RfmForm.names
rfm.penalty: the penalty holds beyond_affine or identity
    -> give one of these words
rfm.few_points: too few control points for {unknowns} coefficients
    -> at least {least} are needed; take a lower degree, common denominators, or a penalty (kappa > 0)
rfm.pole: a denominator vanishes or changes its sign at the control points or between them: the model has a pole
    there
    -> take a lower degree, fewer coefficients or a penalty: <degree>, <select>, <kappa>
rfm.no_end: the iteration does not end
    -> take a lower degree, fewer coefficients or a penalty (kappa > 0)
rfm.folds: the number of folds must lie between 2 and the number of points
    -> there are {points} points
rfm.selector: no such selection of coefficients
    -> choose one of {known}
rfm.grid: the virtual grid needs at least {least} values per axis
    -> take more lines, samples or layers
rfm.heights: the lowest height has to lie below the highest
    -> give the lowest first, then the highest, in m above the ellipsoid
rfm.data: the file must hold rows of id, line, sample, latitude, longitude (degrees), height (m)
    -> give the file of control points of the SPOT-6 scene, or its folder
""")
