"""Messages about the result of an adjustment: how it ended, its verdict, warnings, figures that are not given."""

from __future__ import annotations

from typing import Final

from fg_orient.model.messages.entry import words

WORDS: Final = words("""
loop.small_step (note): the scaled step is below the tolerance
loop.small_step_of_native (note): GTSAM's own optimiser ended with a step of {step:.1e} left
loop.error_rises: the error rises
    -> try <optimizer> levenberg-marquardt
loop.last_step: the last step raised the error
    -> try <optimizer> levenberg-marquardt
loop.no_step: no step lowers the error
    -> look for gross errors, and at the start values
loop.iterations: no convergence within {iterations} iteration(s)
    -> raise <max_iterations>, or look at the start values
loop.weights: the weights have not settled within {cycles} cycles
    -> choose another loss
loop.free_datum: the datum of the free network is not reached
    -> look at the start values
loop.interrupted: interrupted after iteration {iteration}, which {kept} keeps
    -> <resume> goes on from there
verdict.free_datum (doubt): the datum is free: position, orientation and scale of the block are those of its start
    values, only its shape is determined
verdict.weak_control (doubt): without priors the control points determine some directions too weakly for a
    covariance: coordinates must not be trusted
verdict.sigma0 (doubt): sigma0 = {sigma0:.2f} lies above {limit:.2f}, the upper end of its 99.9 % interval: the
    observations do not fit the model within their sigmas. The unknowns cannot take up the errors present, or the
    sigmas are too small, or there are gross errors; standard deviations and coordinates must not be trusted
verdict.loss (doubt): {down} of {n} image points have a weight below {limit}: the model does not hold, or the sigmas
    are too small
verdict.loss_of_images (doubt): most image points of {count} image(s) have a weight below {limit} ({images:10}):
    their orientation rests on the rest and on the priors. Wrong metadata, wrong point numbers, or most control
    there is wrong
verdict.no_redundancy (warning): no redundancy: nothing was checked
verdict.components (warning): sigma0 is 1 by construction, since the sigmas were estimated from these residuals: it
    does not test the model
weights.beyond (warning): robust loss {loss}: {down} of {n} image points and {control} control points lie beyond
    {limit:g} sigmas; their weights fall from the first residual on, so none is turned down, and sigma0 is not that
    of sigmas that hold
weights.below (warning): robust loss {loss}: {down} of {n} image points and {control} control points have a weight
    below {limit}
    + ; its unit is {scale_image:.2f} sigmas of image points and {scale_control:.2f} of control points
    + ; chi2, sigma0 and standard deviations (prior scale) take the weights at the solution as given, and sigma0 is
      not tested
weights.no_ray (warning): the loss has turned down all rays of {n} point(s), whose place nothing checks: {points:10}
    + ; check points among them: {check:10}
weights.one_ray (warning): the loss has turned down all but one ray of {n} point(s), which nothing holds along it:
    {points:10}
    + ; check points among them: {check:10}
solution.sigmas_large (warning): sigma0 lies below {limit:.2f}, the lower end of its 99.9 % interval: the sigmas are
    too large, so the standard deviations in prior scale are too
solution.weak_directions (warning): without priors {n} direction(s) of the block are determined 100 times worse than
    their prior sigma: results along them are not reliable
solution.relative (warning): relative adjustment: no control point tells where the block lies; it moved by
    {moved_m[0]:+.1f}, {moved_m[1]:+.1f}, {moved_m[2]:+.1f} m {axes}. No figure of it is an accuracy; if it moved
    farther than the vendor's own location error, give that error as prior sigma
solution.motions (warning): {direction}
    -> {remedy}
solution.motions_inner (warning): {direction}; inner constraints on the ground points carry them: standard
    deviations are relative
solution.parts (warning): the block falls into {n} parts that no point links: {parts}
    -> measure points in images of both
solution.singular (warning): the normal equations are ill-conditioned: to working precision they are singular
solution.ill_conditioned (warning): the normal equations are ill-conditioned (condition {condition:.0e} with scaled
    unknowns, the limit is {limit:.0e}): solvers agree to about {digits} digits of the image unknowns only
solution.unobservable (warning): {n} direction(s) of the orientation are not observable and are held by their priors
    alone
solution.unobservable_image (warning): {summary}
solution.look_angles (warning): the constant and linear look-angle terms nearly duplicate roll, pitch and yaw: judge
    their sum, not each alone
solution.outside_validity (warning): outside the validity range of the model of image {image}: {n} point(s):
    {points:10}
solution.check_far (warning): check points beyond {limit:.1f} standard deviations of the difference, which chance
    hardly gives among {n} coordinates: {points:10}
solution.check_beyond (warning): check points beyond 3 standard deviations of the difference: {points:10}; {count}
    of {n} check coordinates, {expected:.1f} expected by chance, up to {limit} not unusual
solution.no_check (warning): no check points: the accuracy is not verified independently
solution.few_check (warning): {n} check point(s): ASPRS (2023) asks for at least {least}
solution.check_not_located (warning): {n} excluded check point(s) whose rays hardly meet have no coordinates:
    {points:10}
solution.mix_up (warning): image {image}: its control points lie {best_px:.3g} px beside their places in the image
    with {reading}, and {given_px:.3g} px as they stand (medians)
    -> look at the columns of the table
solution.no_inner_datum (warning): the control points hold the datum, so inner constraints have nothing to do
    -> leave datum = "inner" out
solution.no_inner_datum_nor_priors (warning): the control points hold the datum, so inner constraints have nothing
    to do; the priors of the images were switched off all the same
    -> leave datum = "inner" out to keep them
withheld.free_datum (warning): covariance withheld: the datum is free
    -> keep the priors or measure control points
withheld.loss (warning): covariance withheld: under the loss {loss} residuals near zero get weights above 1, which
    are no information
    -> adjust with another one
withheld.indeterminate (warning): covariance withheld: {why}
    -> measure more control points or keep the priors
withheld.slopes (warning): shift withheld: {n} points over slopes of the model, {least} are needed
withheld.aspects (warning): shift withheld: the terrain has not enough slopes of different aspect to tell East and
    North
withheld.steps (warning): shift withheld: it does not stand after {steps} steps
search.left_out (warning): snooping left out {n} observation(s) in {rounds} rounds: {names:5}
    + ; with them, as single rays of their points: {with_them:5}
search.check_points (warning): {n} check point(s) are not in the accuracy, as snooping left them no two rays:
    {points:5}
search.not_converged (warning): the adjustment does not converge
search.too_many (warning): {percent:.0f} % of the image points are out and more is suspicious: the model or the
    sigmas are wrong, not they
search.impossible (warning): without {name}, the most suspicious, the block cannot be adjusted: {why}
components.held (warning): variance component of {group} is held at the given sigma: {why}
components.lower_bounds (warning): standard deviations of variance components are lower bounds: image unknowns and
    groups are too many to form what groups share; outlier tests take the degrees of freedom of each observation's
    own group, which gives too many false alarms (any in 18 % of simulated blocks instead of 5 %)
absent.no_redundancy (warning): not given: {figures!w}; there is no redundancy, and standard deviations are in prior
    scale
absent.no_unit_weight (warning): not given: {figures!w}; there is no redundancy
absent.loss (warning): not given: {figures!w}; the weights of the loss change them
absent.loss_but_redundancy (warning): not given: {figures!w}; the weights of the loss change them; residuals.csv
    holds the redundancy numbers
absent.components (warning): not given: {figures!w}; with estimated variance components sigma0 is 1 by construction
absent.not_converged (warning): not given: {figures!w}; the adjustment did not converge
absent.covariance (warning): not given: {figures!w}; they need the covariance
absent.basic (warning): not given: {figures!w}; <statistics> is "basic"
absent.large (warning): not given: {figures!w}; the block has more than {limit} image points, or too many image
    unknowns
    -> ask with <statistics> "full"
absent.whole_block (warning): not given: {figures!w}; the block is too large to be decomposed as a whole
absent.no_iteration (warning): not given: {figures!w}; nothing was iterated
absent.nothing_adjusted (warning): not given: {figures!w}; nothing was adjusted
record.sentence (warning): {text}
""")

#: Figures of a record in words; the others are their keys with spaces.
figures_in_words: Final = {
    "sigma0_interval_99_9": "the interval of sigma0", "global_test": "the global test",
    "outlier_tests": "tests of single observations", "suspicious_observations": "suspicious observations",
    "reliability": "redundancy numbers and minimal detectable biases",
    "correlations": "correlations of the orientation", "block_observability": "directions of the whole block",
    "us_per_observation_iteration": "the time per image point and iteration",
}  # fmt: skip
