"""Messages about statistics, dense solvers, published procedures, comparison and reproduction."""

from __future__ import annotations

from typing import Final

from fg_orient.model.messages.entry import words

WORDS: Final = words("""
statistics.groups: there is no such grouping of observations
statistics.method: there is no such method of variance components
curve.optimizer: there is no such optimiser of curves
accuracy.role: there are no points of this role
linear.solver: no solver of this name
linear.kappa_rule: no kappa rule of this name
published.source: no such publication
published.table: no such table in this file
    -> choose one of {known}
statistics.groups_overlap: these groupings overlap: an observation has one variance component
    -> keep one grouping of image points, and either control or position and height
statistics.power: these are not the size and the power of a test
    -> give two probabilities with 0 < alpha < power < 1, such as 0.001 and 0.8
statistics.components_loss: variance components under a robust loss: its weights take from the large residuals, so
    all would be too small
    -> leave the loss out; the method "median" withstands gross errors, or search them first
statistics.component_negative: the variance component runs to zero or below: with a redundancy of {value} the
    residuals of this group are smaller than any error of it would leave
    -> its sigmas cannot be separated from those of another group: leave it out of the groups, or join the two
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
statistics.components_global: the global test is circular with estimated variance components: they bring sigma0 near
    1
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
statistics.motions: nothing fixes these images in the world
    -> {remedy}
statistics.datum: these unknowns do not fix the {count} motions of the free network
    -> name three points or more, not on one line
statistics.no_free_network: this is no free network, or its covariance could not be computed
    -> adjust a block without control points with datum = "inner"
statistics.datum_near: the observations depend weakly on these motions, so they are not an exact datum defect
    -> keep the priors: datum = "vendor"; or measure control points
curve.numbers: these must be finite numbers
    -> give {wanted}
curve.unknowns: {count} observations do not determine {unknowns} unknowns
    -> measure more, or fix unknowns
curve.model: the model must give one finite number per observation at the start values
    -> model(x, *parameters) gives a ({count},) array; look at the start values
curve.derivatives: the derivatives differ from what the model does
    -> use numpy functions that take complex numbers (no abs, no conversion to real), or correct jacobian
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
linear.not_square: the normal matrix must be square and not empty
    -> give N as a (u, u) array
linear.not_symmetric: the normal matrix is not symmetric
    -> form it as A^T W A; (N + N^T)/2 if only rounding differs
linear.not_finite: the normal matrix holds a value that is not finite
    -> look for the observation behind it
linear.not_real: the matrix or vector must hold real numbers
    -> give an array of float64
linear.too_large: more than {limit} unknowns are too many for dense matrices
    -> use the graph backend: its cost grows with the observations only
linear.rhs: the right-hand side must hold {unknowns} finite numbers
    -> give b as a (u,) array
linear.design: the design matrix must be finite with {unknowns} columns and one observation per row
    -> give A as an (r, u) and l as an (r,) array
linear.no_design: this needs the design matrix, and only the normal equations are known
    -> give A and l
linear.zero_pivot: the pivot is zero or not finite
    -> the matrix is singular for this method; take one with pivoting, or a pseudo-inverse
linear.zero_determinant: the determinant is zero
    -> the matrix is singular; take a pseudo-inverse
linear.radicand: the radicand of the Cholesky root is not positive
    -> the matrix is not positive definite, or singular within rounding
linear.dependent_column: the column of A depends on those before it within rounding
    -> the unknown is not determined; take SVD, a prior or fewer unknowns
linear.redundancy: there must be more observations than unknowns
    -> without redundancy residuals say nothing; add observations or take fewer unknowns
linear.kappa_needs: this rule needs {needed}
    -> give it in Given({needed}=...)
linear.truth: the true solution must hold {unknowns} finite numbers
    -> give it in Given(truth=...)
linear.sigmas: standard deviations must be above zero
    -> give them in Given(sigma_observed=..., ...)
linear.kappa_value: kappa must be finite and not negative
    -> 0 gives least squares
linear.no_kappa: the rule finds no usable kappa
    -> take another rule
linear.penalty: the penalty must be a finite matrix of {unknowns} columns
    -> give L as a (k, u) array
linear.library: the linear algebra library cannot go on
    -> the system is singular for this solver
linear.result_shape: the solver must give {unknowns} real numbers
    -> correct the solver's function
linear.result_not_finite: the solver gives values that are not finite
    -> the system is singular for it
classical.weights_twice: weights and cofactors exclude each other
    -> give one of them; Q_ll = W^-1
classical.weights: there must be {count} finite numbers, or a finite matrix of {count} rows and columns
    -> give one per observation
classical.not_definite: weights must be symmetric and positive definite, cofactors symmetric without negative
    eigenvalues
    -> leave out observations without weight; weights are 1/sigma^2, cofactors sigma^2
classical.vector: this must be a vector of finite numbers
    -> give an array of one dimension
classical.function: the function must give arrays of the shapes {expected}
    -> see its documentation
classical.function_not_finite: the function gives values that are not finite
    -> start nearer to the solution, or look for a division by zero
classical.redundancy: too few for {unknowns} unknowns, or none
    -> add observations or conditions, or take fewer unknowns
classical.dependent_conditions: conditions depend on each other, or hold no observation that can move
    -> leave out those that follow from others; an observation of cofactor 0 cannot fulfil a condition
classical.one_image: the published procedure needs at least two images
    -> use fg-orient adjust for a single one
classical.bundle: no such bundle adjustment
    -> give kind 1 or 2, and one iteration or more
classical.few_control: the look-angle polynomial needs control points in at least {least} different columns
    -> measure more control points in this image, or use fg-orient adjust
published.folder: this is no folder
    -> give a copy of the folder of the published tables
published.unreadable: the table of published values cannot be read
published.column: columns of the published table are missing
published.row: the record must have {count} cells
published.count: the table must hold {count} cells
    -> copy the original file again
published.not_a_number: this is not a number
    -> write it as 123.4, 1.2e-3 or nan; nothing where nothing is printed
published.twice: the cell stands twice; first in {first}
    -> remove the wrong one
published.unknown_cell: the publication has no such cell
    -> alter values only; copy the original file again
reproduce.table: no such table, or a range that runs backwards
    -> known, in order: {known}
compare.no_figures (warning): no figures: matplotlib is missing
    -> install it: pip install "fg-orient[report]"
compare.type: no such type of pre-adjustment
    -> give 1 (look angles), 2 (look angles and EOPs) or both
compare.nothing: this selects nothing
    -> name what to compare, or leave the option out for its default
compare.target: the target must be a length above zero
    -> give it in m, or leave it out for one pixel
compare.slow: left out: this solver takes u^2 determinants, minutes beyond {limit} unknowns
    -> any other solver gives the same answer where this one would
compare.damped: left out: regularised steps only slow the iteration on its way to the same minimum
    -> the priors regularise here; the published procedure takes a single step
compare.no_solution: none of the {count} adjustments has a solution; the first says: {why}
    -> the table gives the reason of each
""")
