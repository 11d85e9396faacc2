"""Messages about statistics: variance components, significance, reduction of unknowns."""

from __future__ import annotations

from typing import Final

from fg_orient.model.messages.entry import words

WORDS: Final = words("""
statistics.groups: there is no such grouping of observations
    -> choose one of {known}
statistics.groups_overlap: these groupings overlap: an observation has one variance component
    -> keep one grouping of image points, and either control or position and height
statistics.power: these are not the size and the power of a test
    -> give two probabilities with 0 < alpha < power < 1, such as 0.001 and 0.8
statistics.method: there is no such method of variance components
    -> choose one of {known}
statistics.components_loss: variance components under a robust loss: its weights take from the large residuals, so
    all would be too small
    -> leave the loss out; the method "median" withstands gross errors, or search them first
statistics.component_negative: the variance component runs to zero or below: with a redundancy of {value} the
    residuals of this group are smaller than any error of it would leave
    -> its sigmas cannot be told from those of another group: leave it out of the groups, or join the two
statistics.component_explodes: the variance component runs away: the sigmas would have to be {value} times as large
    -> check the units of the sigmas, and search for gross errors or a wrong model first
statistics.component_unsettled: the variance component does not stand after {value} adjustments
    -> leave it out of the groups, or join it with another
statistics.global_weighted: the global test needs least squares: the weights of a loss take from the large
    residuals, so that the sum of squares follows no chi-square
    -> judge the fit by the weights and the check points, or adjust with loss none
statistics.significance_weighted: tests of unknowns need least squares: under a loss sigma0 is no unit weight, and
    too much looks significant
    -> search for gross errors first, then adjust without them and with loss none
statistics.reliability_weighted: minimal detectable biases are those of a test under least squares: the weights of a
    loss change its size and its power
    -> adjust with loss none; redundancy numbers with the weights are in residual_cofactors
statistics.components_global: the global test is circular with estimated variance components: they make sigma0 1
    -> test the model with the sigmas given, or by check points
statistics.components_large: estimated sigmas leave tests of unknowns degrees of freedom of their own, and with
    {value} unknowns of images in {groups} groups they are too large to form
    -> name fewer groups (not image_by_image), or fix the sigmas found in the input and adjust without components
statistics.no_redundancy: there is no redundancy, so there is no unit weight to test unknowns with
    -> measure more points, or choose a smaller set of unknowns
statistics.folds: cross-validation leaves out parts of the control points, of which {control} are seen
    -> leave out one at a time (loo; in Python 0), or in 2 parts up to as many as these points; two are the least
statistics.snoop_loss: gross errors are searched with least squares, not under a robust loss that has weighted them
    down
    -> leave out the loss, or the search
statistics.sigma_px: no usable sigma of the pixel
    -> give two sigmas above zero; without them the image must have measurements of its own
statistics.one_height: a pixel is located at a height or on a DEM
    -> give one of the two
statistics.height_sigma: the sigma of a height is no number from 0
    -> give it in metres; 0 for an exact height
statistics.dem_border: the DEM has no slope here
    -> take a larger DEM: the point lies at its border
statistics.one_image: rays of one image do not intersect
    -> name two images or more, or locate at a height
statistics.not_located: the intersection of these rays does not settle in {value} steps: they are nearly parallel,
    or do not meet
    -> check the pixels, or locate one of them at a height
statistics.too_few: too few observations
    -> {remedy}
statistics.motions: nothing fixes these images in the world
    -> {remedy}
statistics.datum: these unknowns do not fix the {count} motions of the free network
    -> name three points or more, not on one line
statistics.no_free_network: this is no free network, or its covariance could not be computed
    -> adjust a block without control points with datum = "inner"
statistics.datum_near: the models feel these motions a little, so they are no exact datum defect
    -> keep the priors: datum = "priors"; or measure control points
curve.numbers: these must be finite numbers
    -> give {wanted}
curve.unknowns: {count} observations do not determine {unknowns} unknowns
    -> measure more, or fix unknowns
curve.model: the model must give one finite number per observation at the start values
    -> model(x, *parameters) gives a ({count},) array; look at the start values
curve.derivatives: the derivatives differ from what the model does
    -> use numpy functions that take complex numbers (no abs, no conversion to real), or mend jacobian
curve.optimizer: there is no such optimiser of curves
    -> choose one of {known}
curve.lost: the iteration has come to where the model is not finite or does not depend on every parameter
    -> start nearer, or with levenberg-marquardt
accuracy.no_check: there are no check points to hold the predicted accuracy against
    -> withhold some points
accuracy.check_excluded: check points that are located afterwards have no joint covariance, and their errors are not
    independent
    -> keep check_points = "use": their coordinates stay withheld all the same
accuracy.dem_outside: no point lies over the elevation model
    -> check its extent and coordinate system
accuracy.local: points of a local coordinate system do not lie over an elevation model
    -> use control points in a coordinate system of the Earth
accuracy.role: there are no points of this role
    -> choose one of {known}
""")
