"""Messages about statistics, dense solvers, published procedures, comparison and reproduction."""

from __future__ import annotations

from typing import Final

from fg_orient.model.messages.entry import words

WORDS: Final = words("""
statistics.groups: unknown grouping of observations
statistics.method: unknown method of variance components
curve.optimizer: unknown optimiser of curves
accuracy.role: there are no points with this role
linear.solver: unknown solver
linear.kappa_rule: unknown kappa rule
published.source: unknown publication
published.table: the file has no table of this name
    -> choose one of {known}
statistics.groups_overlap: these groupings overlap, but an observation can have only one variance component
    -> keep one grouping of image points, and either control or position and height
statistics.power: these values are not possible as significance level alpha and power of a test
    -> give two probabilities with 0 < alpha < power < 1, such as 0.001 and 0.8
statistics.components_loss: a robust loss down-weights large residuals, so estimated variance components would be too
    small
    -> leave the loss out; the method "median" is robust against gross errors; or search for gross errors first
statistics.component_negative: the variance component becomes zero or negative: with a redundancy of {value} the
    residuals of this group are smaller than any positive variance would explain
    -> the sigmas of this group and of another group cannot be separated: leave this group out, or join the two groups
statistics.component_explodes: the variance component diverges: the sigmas would have to be {value} times as large
    -> check the units of the sigmas, and search for gross errors or a wrong model first
statistics.component_unsettled: the variance component has not converged after {value} adjustments
    -> leave this group out, or join it with another group
statistics.global_weighted: the global test needs least squares: a loss down-weights large residuals, so the sum of
    squares does not follow a chi-square distribution
    -> assess the fit by the weights and the check points, or adjust with loss none
statistics.significance_weighted: tests of unknowns need least squares: under a loss sigma0 does not estimate the unit
    weight, and too many unknowns look significant
    -> search for gross errors first, then adjust without them and with loss none
statistics.significance_regularised: tests of unknowns need an estimate without bias; this one is regularised
    -> leave <regularisation> out and keep the priors
statistics.reliability_weighted: minimal detectable biases belong to a least-squares test: the weights of a loss change
    the significance level and the power of this test
    -> adjust with loss none; redundancy numbers with the weights are in residual_cofactors
statistics.components_global: the global test is circular with estimated variance components, which bring sigma0 near 1
    -> test the model with the sigmas given, or by check points
statistics.components_large: with estimated sigmas each test of an unknown needs its own degrees of freedom; with
    {value} image unknowns in {groups} groups they cannot be computed, because the matrices are too large
    -> name fewer groups (not image_by_image), or write the estimated sigmas into the input and adjust without
       components
statistics.no_redundancy: there is no redundancy, so unknowns cannot be tested with sigma0
    -> measure more points, or choose a smaller set of unknowns
statistics.folds: cross-validation leaves out parts of the {control} measured control points
    -> leave out one point at a time (loo; in Python 0), or give a number of parts from 2 to the number of these points
statistics.snoop_loss: the search for gross errors needs least squares: a robust loss has already down-weighted them
    -> leave out the loss, or the search
statistics.sigma_px: the sigma of the pixel is missing or not usable
    -> give two sigmas above zero; without them the image must have measurements
statistics.one_height: a pixel can be located at a height or on a DEM, not both
    -> give one of the two
statistics.height_sigma: the sigma of a height must be zero or positive
    -> give it in metres; 0 for an exact height
statistics.dem_border: the DEM has no slope here
    -> use a larger DEM: the point is at the border of this DEM
statistics.one_image: the rays of one image do not intersect each other
    -> name two images or more, or locate at a height
statistics.not_located: the intersection of these rays does not converge in {value} steps: they are nearly parallel, or
    do not meet
    -> check the pixels, or locate one of them at a height
statistics.too_few: too few observations
statistics.motions: the position of these images on the ground is not determined
    -> {remedy}
statistics.datum: these unknowns do not fix the {count} motions of the free network
    -> name three points or more, not on one line
statistics.no_free_network: this is not a free network, or its covariance could not be computed
    -> adjust a block without control points with datum = "inner"
statistics.datum_near: the observations depend weakly on these motions, so the motions are not an exact datum defect
    -> keep the priors with datum = "vendor", or measure control points
curve.numbers: these values must be finite numbers
    -> give {wanted}
curve.unknowns: {count} observations do not determine {unknowns} unknowns
    -> measure more observations, or fix unknowns
curve.model: the model must give one finite number per observation at the start values
    -> model(x, *parameters) gives a ({count},) array; check the start values
curve.derivatives: the derivatives do not agree with the model
    -> use numpy functions that take complex numbers (no abs, no conversion to real), or correct jacobian
curve.lost: the iteration has reached values at which the model is not finite or does not depend on every parameter
    -> start nearer to the solution, or use levenberg-marquardt
accuracy.no_check: there are no check points to compare with the predicted accuracy
    -> give some points the role check
accuracy.check_excluded: check points that are located after the adjustment have no joint covariance, and their errors
    are correlated
    -> keep check_points = "use", which does not use their coordinates either
accuracy.dem_outside: no point is inside the elevation model
    -> check the extent of the elevation model and coordinate system
accuracy.local: points in a local coordinate system cannot be compared with an elevation model
    -> use control points in a coordinate system of the Earth
linear.not_square: the normal matrix must be square and not empty
    -> give N as a (u, u) array
linear.not_symmetric: the normal matrix is not symmetric
    -> form it as A^T W A, or give (N + N^T)/2 if the difference is only rounding
linear.not_finite: the normal matrix contains a value that is not finite
    -> find the observation that causes it
linear.not_real: the matrix or vector must contain real numbers
    -> give an array of float64
linear.too_large: more than {limit} unknowns are too many for dense matrices
    -> use the graph backend: its cost grows only with the number of observations
linear.rhs: the right-hand side must contain {unknowns} finite numbers
    -> give b as a (u,) array
linear.design: the design matrix must be finite, with {unknowns} columns and one row per observation
    -> give A as an (r, u) and l as an (r,) array
linear.no_design: this needs the design matrix, and only the normal equations are known
    -> give A and l
linear.zero_pivot: the pivot is zero or not finite
    -> the matrix is singular for this method; choose a method with pivoting, or a pseudo-inverse
linear.zero_determinant: the determinant is zero
    -> the matrix is singular; choose a pseudo-inverse
linear.radicand: the radicand of the Cholesky root is not positive
    -> the matrix is not positive definite, or is singular within rounding
linear.dependent_column: the column of A depends on those before it within rounding
    -> the unknown is not determined; use SVD, a prior or fewer unknowns
linear.redundancy: there must be more observations than unknowns
    -> add observations, or use fewer unknowns
linear.kappa_needs: this rule needs {needed}
    -> give this value in Given({needed}=...)
linear.truth: the true solution must contain {unknowns} finite numbers
    -> give it in Given(truth=...)
linear.sigmas: standard deviations must be above zero
    -> give them in Given(sigma_observed=..., ...)
linear.kappa_value: kappa must be finite and not negative
    -> 0 gives least squares
linear.no_kappa: the rule finds no usable kappa
    -> choose another rule
linear.penalty: the penalty must be a finite matrix of {unknowns} columns
    -> give L as a (k, u) array
linear.library: the linear algebra library stopped
    -> the system is singular for this solver
linear.result_shape: the solver must return {unknowns} real numbers
    -> correct the solver's function
linear.result_not_finite: the solver returned values that are not finite
    -> the system is singular for this solver
classical.weights_twice: weights and cofactors are both given
    -> give only one of them; Q_ll = W^-1
classical.weights: this must be {count} finite numbers, or a finite matrix of {count} rows and columns
    -> give one per observation
classical.not_definite: weights must be symmetric and positive definite; cofactors must be symmetric without negative
    eigenvalues
    -> leave out observations of weight zero; weights are 1/sigma^2, cofactors sigma^2
classical.vector: this must be a vector of finite numbers
    -> give an array of one dimension
classical.function: the function must return arrays of the shapes {expected}
    -> see its documentation
classical.function_not_finite: the function returned values that are not finite
    -> start nearer to the solution, or check for a division by zero
classical.redundancy: there are too few for {unknowns} unknowns
    -> add observations or conditions, or use fewer unknowns
classical.dependent_conditions: conditions depend on each other, or a condition contains only observations of cofactor
    0
    -> leave out conditions that follow from others; observations of cofactor 0 cannot be adjusted to meet a condition
classical.one_image: the published procedure needs at least two images
    -> use fg-orient adjust for a single one
classical.bundle: this bundle adjustment is not possible
    -> give kind 1 or 2, and one iteration or more
classical.few_control: the look-angle polynomial needs control points in at least {least} different columns
    -> measure more control points in this image, or use fg-orient adjust
published.folder: this is not a folder
    -> give a copy of the folder of the published tables
published.unreadable: the table of published values cannot be read
published.column: columns of the published table are missing
published.row: the record must have {count} cells
published.count: the table must have {count} cells
    -> copy the original file again
published.not_a_number: this is not a number
    -> write it as 123.4, 1.2e-3 or nan; leave the cell empty if nothing is printed
published.twice: the cell occurs twice, first in {first}
    -> remove the wrong cell
published.unknown_cell: the publication does not have this cell
    -> change values only; copy the original file again
reproduce.table: unknown table, or a range from a later to an earlier table
    -> known, in order: {known}
compare.no_figures (warning): no figures are drawn, because matplotlib is not installed
    -> install the extra: pip install "fg-orient[report]"
compare.type: unknown type of pre-adjustment
    -> give 1 (look angles), 2 (look angles and EOPs) or both
compare.nothing: this selection is empty
    -> name what to compare, or leave the option out for its default
compare.target: the target must be a length above zero
    -> give it in m, or leave the option out for the predicted accuracy
compare.time_limit: the limit of the time must be above zero
    -> give it in seconds of processor time for each adjustment
compare.size: a size is a whole number of image points from {least} to {most}
    -> such as 10,1e3,1e5
compare.with_scale: a study of sizes makes its own blocks and does not have this option
    -> leave it out, or leave out <scale>
compare.no_project: a comparison needs a project file, and <sizes> belong to <scale>
    -> give PROJECT.toml, or <scale>
compare.memory: not tried: it needs an estimated {needed}, and {allowed} are allowed
    -> <memory_limit_gb> sets the limit
compare.time: not tried: it needs an estimated {seconds:.3g} s of processor time, more than {limit:.3g} s
    -> <time_limit_s> sets the limit
compare.named: not tried: extra observations name ground points, which arrays cannot eliminate
    -> see the rows of the graph, which has these points as variables
compare.shared: not tried: images share unknowns, and the reduced matrix is then stored in full
    -> see the row of the full Cholesky factor
compare.full: not tried: the reduced matrix has no band that is narrower than the matrix, or is too large
    -> see the rows of the other methods
compare.not_eliminated: not tried: without priors the graph does not eliminate points
    -> see the rows of the explicit graph
compare.ill_conditioned: not tried: the regularised equations have the condition {condition:.1e}, above {limit:.0e},
    and normal equations lose the weakest direction
    -> see the rows of full matrices and of the explicit graph
compare.regularisation: unknown regularisation
    -> give METHOD, METHOD:RULE or METHOD:KAPPA, for a method without kappa METHOD:CUT with a cut of the rank below 1.
    Methods are {methods}; rules are {rules}
compare.no_reference (note): forward errors are not computed, because python-flint is not installed
    -> install the extra: pip install "fg-orient[reference]"
compare.damped: left out: regularised steps converge more slowly to the same minimum
    -> the priors already regularise this adjustment; only the published procedure uses regularised solvers, because it
       makes a single step
compare.no_solution: none of the {count} adjustments has a solution; reason of the first: {why}
    -> the table gives the reason of each
""")
