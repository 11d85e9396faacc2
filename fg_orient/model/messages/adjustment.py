"""Messages about an adjustment: parameters, options, backends, parts; its result and remarks."""

from __future__ import annotations

from typing import Final

from fg_orient.model.messages.entry import words

WORDS: Final = words("""
parameters.eop_set: no such EOP set
    -> give a number or a name: {names}
parameters.unknowns: the image has none of these unknowns, so nothing can be adjusted
    -> choose one of {known}
parameters.unknown: no image of the block has such an unknown
    -> names are those of eop.csv, such as x_0, roll_1, psi_y_s1 or line_l1
options.value: the value of this option is not allowed
    -> give {expected}
initial.no_intersection: no start value: its rays are less than {least} degrees from parallel
    -> measure the point in another image, give it coordinates as control, or remove it
initial.seen_once: seen in {image} only, without control: 1 free motion, along the ray
    -> measure the point in another image, give it coordinates as control, or remove it
initial.pixel_count: lines and samples must have one row for each of the {sensors} sensors, of the same length
    -> give (k,) or (k, N) arrays, row k for sensor k
initial.correction_count: there must be one correction for each of the {sensors} sensors
    -> give one per sensor, None where the metadata orientation is meant
initial.behind: its rays meet behind a sensor
    -> check the point's identity in every image
adjust.memory: the adjustment exceeds the memory limit of {allowed}
    -> choose backend schur if it is another one, adjust in parts on several machines (docs/parallel.md), take a
       machine with more memory, or raise <memory_limit_gb>
adjust.in_parts (note): the whole block needs {value} of memory, {allowed} are allowed: the ground points are adjusted
    in {parts} parts, whose arrays are in files, {kept} of them in memory at once
adjust.backend: this backend does not exist in this version
    -> choose one of {known}
adjust.no_model: images of this sensor cannot be adjusted
    -> derive its class from fg_orient.Sensor and give it the method image_model (docs/extending)
adjust.vendor_datum: a block of {n} image unknowns is too large for this datum
    -> datum = "priors", with the vendor's location error as prior sigma
adjust.vendor_datum_points: the datum needs points that their rays determine: {why}
    -> measure further image points, or datum = "priors"
adjust.relative_priors: without control points and priors the datum of the block is not defined
    -> keep the priors, or leave out datum = "priors" and measure control points; datum = "free" lets the block
       float
adjust.solver_dense: a linear solver can be chosen for the dense backend only; the backend is {backend}
    -> add <backend> dense, or leave the solver out
checkpoint.unreadable: this is not a checkpoint of this version
    -> remove the file, or leave <resume> out to start from the beginning
checkpoint.other: the checkpoint belongs to other input files or options
    -> give the options of the run that was stopped, or leave <resume> out to start from the beginning
adjust.loss: there is no such robust loss
    -> choose one of {known}
adjust.gnc: graduated non-convexity leads to a bounded loss
    -> choose one of {known}, or leave gnc out
adjust.needs_loss: this is for an adjustment with a robust loss
    -> add <loss> tukey or another redescending loss, or leave it out
adjust.gnc_start: graduated non-convexity begins with least squares and takes the sigmas as they are
    -> leave gnc out, or robust_start and robust_scale
adjust.few_control: too few control points, or points that two oriented images see, for a robust start by resection
    -> measure {least} or more in the image, or choose robust_start huber
adjust.cycles: this loss has no cost function
    -> leave gnc, robust_start, robust_scale and parts out, or choose a loss among {known}
graph.own_optimizer: this is not possible with an optimiser of one's own
    -> leave it out, or name one of the program's optimisers
graph.loss: a factor graph holds no robust loss
    -> leave <loss> out, or put a loss into the noise models of own factors
graph.no_priors: points cannot be eliminated without priors
    -> keep the priors, or ask for points = "explicit"
graph.no_factor: this is neither an ExtraObservation nor a factor of GTSAM
    -> give a gtsam.NonlinearFactor, or an ExtraObservation
graph.key: this key is no variable of the block
    -> take keys from fg.factor_graph(block).key("point:12"), or key("image:left")
graph.broken_factor: this factor cannot be evaluated: {why}
    -> check that images are vectors of their unknowns and points Point3, and that its sigmas are not zero
graph.name: this name has no variable in the graph
    -> name "image:ID", "shared:ID", or "point:ID" of an unknown point; eliminated points are no variables
earlier.no_start: there is no earlier result to take the prior from
    -> add <start>
earlier.no_image: no image of this block is in the earlier result, which has {value}
    -> give a result that has images of this block, under the same ids
earlier.size: the image of the earlier result has another size; here it has {lines} x {samples} pixels
    -> give a result of the same images, or rename the image
earlier.unknowns: these unknowns are unknowns of only one of both adjustments
    -> adjust with the same EOP set and the same options of unknowns as in the earlier run
earlier.metadata: the metadata file of the image has changed since the earlier run
    -> bring back the file of the earlier run: corrections refer to it
earlier.not_converged: the earlier adjustment did not converge, so its covariance is not a prior
    -> leave <start_prior> out
earlier.no_covariance: the earlier result has no joint covariance ({name}): it needs <statistics> "full", another
       datum than "inner", and at most {limit} unknowns of images and control points
    -> adjust the earlier block again with <statistics> "full", or leave <start_prior> out
earlier.components: the covariance of the earlier result is given in prior sigmas, which may not be estimated
    -> leave "priors" out of <variance_components>, or leave <start_prior> out
earlier.inner: a free network has no prior
    -> give another <datum>, or leave <start_prior> out
earlier.check: these check points were control points of the earlier result, so they are no independent check
    -> make them control points, give a result without them, or leave <start_prior> out
earlier.shared: this unknown of the image is shared under another id in the earlier result
    -> give the cameras the same ids as in the earlier run
earlier.singular: the covariance of the earlier result is not positive definite
    -> leave <start_prior> out
adjust.schur: the Schur backend cannot take this block: {value}
    -> choose <backend> graph, or auto
adjust.rank_deficient: not observable without priors
    -> keep the priors, choose a smaller EOP set, or add <regularisation> tikhonov
adjust.rank_without_control: not observable without priors, and the block has no control point
    -> keep the priors: datum = "priors"; or choose a smaller EOP set, or add <regularisation> tikhonov
regularise.penalty: only Tikhonov's method has such a penalty
    -> add <regularisation> tikhonov, or leave the penalty out
regularise.datum: a regularisation keeps the block at the metadata, so it cannot have this datum
    -> leave the datum or <regularisation> out
regularise.condition: the normal equations of this rank have condition {condition:.1e}, above {limit:.0e}, and lose the
    weakest directions
    -> choose <backend> graph or dense, or raise <rank_cut>
regularise.weak (doubt): the rank counts {n} direction(s) in which the observations allow more than
    {prior_sigmas:.0e} prior sigmas; the unknowns are not usable
    -> raise <rank_cut>, or choose <regularisation> tikhonov or truncated
regularise.rank_ambiguous (doubt): the rank {rank} of the {z} image unknowns is ambiguous: the singular values on both
    sides of the cut {cut:.2g} are {above:.2g} and {below:.2g} of the largest, and a gap of {gap:.0f} is required
    -> set <rank_cut> to a value inside a gap of the spectrum, or choose <regularisation> tikhonov
solution.regularised (note): the {z} image unknowns are regularised ({method}
    + , kappa {kappa}
    + , {held} direction(s) held at the metadata
    + ): the estimate is biased, and its standard deviations do not contain the bias
regularise.zero: the observations do not depend on the image unknowns
    -> check the points and the unknowns
regularise.common_null: neither the observations nor the penalty determine {n} direction(s) of the image unknowns
    -> add <penalty_deviation>, choose <penalty> deviation, or keep the priors
regularise.rule_large: this rule needs a decomposition, or no priors, in a block of so many image unknowns
    -> choose one of {known}, or give <kappa> a number
regularise.rule_priors: this rule is not defined beside priors, units or a penalty of this kind
    -> choose one of {known}, leave the priors out, or give <kappa> a number
adjust.extra_kind: an extra observation wants the other kind of unknown for its argument {argument}
    -> give a point as "point:12", an image as "image:left", in the order of the equation
adjust.extra_unused: an extra observation names a point that takes no part in the adjustment
    -> measure the point in two images, or let check points take part (<check_points> use)
adjust.extra_constant: an extra observation between constants only adjusts nothing
    -> name at least one point or image that is an unknown
adjust.broken_down: the normal equations cannot be solved: {why}
    -> keep the priors, choose a smaller EOP set, measure more control points, or check sigmas and start values
adjust.extra_unknown: an extra observation names no image or point of the block
    -> name them as "image:left" or "point:12"
covariance.weighted: gross errors are not tested for under a robust loss: it has weighted them down
    -> look at the weights, or adjust with loss none
covariance.unavailable: no covariance was computed
    -> see the warnings of the adjustment
covariance.no_such: no such image, parameter, point or observation
    -> name them as "image:left", "image:left.x_0", "point:12", "observation:left/12" or "residual:left/12"
covariance.not_unknown: not an unknown of the adjustment: no covariance
    -> ask for adjusted points only
block.not_finite: pixels, coordinates or sigmas are not finite, or sigmas not positive
    -> correct them or leave the point out
block.no_rays: no image point takes part in the adjustment
    -> measure points in two images at least; check points alone determine nothing where they are excluded
block.no_control: no control point is measured in any image: the block has no datum
    -> give at least one point of role control, better six or more well spread; or datum = "vendor" for a relative
       adjustment, whose result has no accuracy
remark.sigma_ground (note): standard deviations outside {low:g} .. {high:g} m at {count} point(s)
    -> check that they are in metres
remark.sigma_image (note): standard deviations outside {low:g} .. {high:g} pixels in {count} record(s)
    -> check that they are in pixels
remark.not_measured (note): {count} point(s) are measured in no image and left out
    -> measure them, if they should count
remark.seen_once (note): {count} check or tie point(s) with a single ray are left out
    -> measure them in a second image
remark.grid_missing (note): a more accurate coordinate operation exists; the one used is good to {accuracy}
    -> install {grids} (projsync) if that matters
remark.few_control (note): only {count} control point(s) measured
    -> use six or more, well spread: errors of control are found only if there is a surplus
remark.control_line (note): the control points lie close to a line: {across_m:.0f} m wide, {along_m:.0f} m long
    -> add control off the line: priors dominate roll and pitch
remark.control_clustered (note): the control points of image {image} cover only {lines:.0%} of its lines and
    {samples:.0%} of its samples
    -> add control in the rest of the image
remark.control_one_image (note): control points are measured in image {image} only
    -> measure control in the other images, too
remark.few_check (note): {count} check points: fewer than the 30 of ASPRS 2023, the accuracy figures are uncertain
    -> add check points if you can
options.two_ways: these options exclude each other
    -> give only one of {option}
parallel.number: this number is not possible
    -> give a whole number from {low} to {high}
parallel.kind: this kind of value is not possible
    -> give {expected}
parallel.parts: the {points} ground points cannot be divided into so many parts
    -> give a number from 1 to {points}, or leave it out
parallel.no_parts: a work folder is for a block in parts, and nothing divides this one
    -> give parts, workers or a scheduler, or leave the work folder out
parallel.backend: parts are adjusted by the Schur backend, not by {value}
    -> leave the backend out, or adjust without parts and workers
parallel.dask: several workers need dask, which is missing
    -> pip install "fg-orient[cluster]", or one worker
parallel.unreachable: no scheduler answers at this address
    -> start dask scheduler and workers, see docs/parallel.md
parallel.folder: a file of the work folder cannot be read where the work is done
    -> give a folder that all workers see under the same name (<work_dir>)
parallel.version: the worker has another version of fg_orient than {written}
    -> install the same version everywhere: results must not depend on the worker
parallel.killed: the same work ended several workers
    -> look at the memory of the workers: take fewer of them, or more parts (a checkpoint needs the same parts)
parallel.lost: the cluster has gone or no longer answers
    -> look at its scheduler; adjust goes on with <resume>
parallel.result: this file of an earlier run cannot be read
    -> remove it; its case is then computed again
loop.small_step (note): the scaled step is below the tolerance
loop.small_step_damped (note): Gauss-Newton raised the cost and Levenberg-Marquardt continued; the scaled step is below
    the tolerance
loop.given (note): the whitened gradient is near zero at the values given
loop.gradient_left: the optimiser ended with a Gauss-Newton step of {step:.1e} left, {gradient:.1e} standard deviations
    -> try <optimizer> levenberg-marquardt, or look for gross errors
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
verdict.sigma0 (doubt): sigma0 = {size:.2f} lies above {limit:.2f}, the upper end of its 99.9 % interval: the
    observations do not fit the model within their sigmas. The unknowns cannot take up the errors present, or the
    sigmas are too small, or there are gross errors; standard deviations and coordinates must not be trusted
verdict.sigma0_regularised (doubt): sigma0 = {size:.2f} lies above {limit:.2f}, the upper end of its 99.9 % interval;
    {share:.0%} of the weighted sum of squares is that of the penalty. If this is a large part, kappa is too large for
    the deviations from the metadata; else the observations do not fit the model within their sigmas
    -> give a smaller <kappa> or another <kappa_rule>; look for gross errors
verdict.gross_error (doubt): gross error suspected
    + , of about {error} {unit}
    + ; {symbol} = {size:.1f}, which fewer than {level:g} % of blocks without gross errors exceed
    + ; or in {also:5}, which cannot be separated from it
    + ; {more} more observation(s) are above their limits, perhaps because of this error
    -> correct the measurement or the coordinates, search with <snoop>, or <accept> "gross_error:{place}"
verdict.sigmas (doubt): the stated standard deviations are too small: {words}; if they were right, fewer than
    {level:g} % of blocks would have such residuals. Standard deviations and coordinates must not be trusted
    + ; those of {more} are too small, too
    -> correct them, let <variance_components> estimate them, or <accept> "sigmas:{place}<={size:.3g}"
verdict.sigmas_large (note): the stated standard deviations are too large: {words}; the observations have too little
    weight, and the result looks less accurate than it is
    -> correct them, or let <variance_components> estimate them
verdict.beyond_prior (doubt): the adjusted value differs by {correction:+.3g} {unit} from the metadata, {size:.1f}
    times the standard deviation of this difference; the prior standard deviation is {sigma:.3g} {unit}
    + ; {more} more unknown(s) are beyond their priors
    -> look for wrong metadata, exchanged images or wrong control points, give a larger prior standard deviation if
    the metadata can be that wrong, or <accept> "beyond_prior:{place}"
verdict.accuracy (doubt): {n} of {of} points have a standard deviation above the required {required:g} m, at most
    {size:.3g} m: {points:10}
    -> add control points or images, or <accept> "accuracy<={size:.3g}"
verdict.accuracy_unknown (doubt): the required accuracy of {required:g} m is not verified, because there is no
    covariance
verdict.check_far (doubt): check points contradict the adjusted points: {points:10}; the largest difference is
    {size:.1f} times its standard deviation, which chance hardly gives among {n} coordinates (limit {limit:.1f})
    -> look at the coordinates and image points of these points, or <accept> "check_far<={size:.3g}"
verdict.check_beyond (doubt): check points contradict the adjusted points: {size} of {n} check coordinates are beyond
    3 standard deviations of the difference, {expected:.1f} expected; with the joint covariance fewer than {level:g} %
    of blocks without mistakes have as many: {points:10}
    -> compare datum, heights and sigmas of control and check points, or <accept> "check_beyond<={size}"
verdict.cause (note): likely cause: {what}; twofold logarithm of the likelihood ratio to no mistake: {gain:.1f}
    + ; without it sigma0 {before} -> {after}, and {left}
    + ; cannot be told apart from: {also}
    -> {cure}
verdict.accepted (note): accepted by <accept>: {names:10}
verdict.loss (doubt): {down} of {n} image points have a weight below {limit}: the model does not hold, or the sigmas
    are too small
verdict.loss_of_images (doubt): most image points of {count} image(s) have a weight below {limit} ({images:10}):
    their orientation rests on the rest and on the priors. Wrong metadata, wrong point numbers, or most control
    there is wrong
verdict.no_redundancy (warning): no redundancy: nothing was checked
verdict.components (warning): sigma0 does not test the model: the sigmas were estimated from these residuals, which
    brings it near 1
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
solution.weak_directions (warning): without priors {n} block direction(s) are determined 100 times worse than
    their prior sigma: results along them are not reliable
solution.relative (warning): relative adjustment: no control point tells where the block lies; it moved by
    {moved_m[0]:+.1f}, {moved_m[1]:+.1f}, {moved_m[2]:+.1f} m {axes}, and at the metadata the rays of a point miss each
    other by {disagreement_m:.2f} m (RMS). No figure of it is an accuracy
    -> datum = "vendor" holds the directions that the rays hardly see; measure control points for an accuracy
solution.vendor_datum (note): {n} directions of the images that the rays hardly see are held at the metadata; standard
    deviations are relative. By the prior sigmas the whole block has a standard deviation of {east:.3g}, {north:.3g},
    {up:.3g} m East, North, Up along these directions
solution.motions (warning): {direction}
    -> {remedy}
solution.motions_inner (warning): {direction}; inner constraints on the ground points carry them: standard
    deviations are relative
solution.parts (warning): the block falls into {n} parts that no point links: {parts}
    -> measure points in images of both
solution.singular (warning): the normal equations are ill-conditioned: to working precision they are singular
solution.ill_conditioned (warning): the normal equations are ill-conditioned (condition {condition:.0e} with scaled
    unknowns, the limit is {limit:.0e}): solvers agree to about {digits} digits of the image unknowns only
solution.unobservable (warning): {n} orientation direction(s) are not observable and are held by {holder}
    alone
solution.unobservable_image (warning): {summary}
solution.look_angles (warning): the constant and linear look-angle terms nearly duplicate roll, pitch and yaw: judge
    their sum, not each alone
solution.outside_validity (warning): outside the validity range of the model of image {image}: {n} point(s):
    {points:10}
solution.no_check (warning): no check points: the accuracy is not verified independently
solution.wide_factor (note): the images see points together in such a way that GTSAM eliminates {n} unknowns together,
    about {seconds:.1f} s for each iteration -> backend schur solves the same equations by LAPACK in less time
solution.few_check (warning): {n} check point(s): ASPRS (2023) asks for at least {least}
solution.check_not_located (warning): {n} excluded check point(s) whose rays hardly meet have no coordinates:
    {points:10}
solution.mix_up (doubt): image {image}: {n} of its {of} control points lie {best_px:.3g} px from their places in the
    image with {reading}, and {given_px:.3g} px as they stand (medians)
    + ; with this, sigma0 {before} -> {after}, and {left}
    -> look at the columns of the table and at the metadata file of the image
solution.id_mix_up (doubt): {what}; they lie {best_px:.3g} px from there, and {given_px:.3g} px from the place of their
    own id (medians)
    + ; with this, sigma0 {before} -> {after}, and {left}
    -> give the right ids in the tables of points and image points
solution.id_copied (doubt): its coordinates are those of control point {other}, and its image points lie {given_px:.3g}
    px from there (median): one control point stands in the table under two ids
    + ; without its coordinates, sigma0 {before} -> {after}, and {left}
    -> give the coordinates of this point
solution.no_inner_datum (warning): the control points hold the datum, so inner constraints have nothing to do
    -> leave datum = "inner" out
solution.no_inner_datum_nor_priors (warning): the control points hold the datum, so inner constraints have nothing
    to do; the priors of the images were switched off all the same
    -> leave datum = "inner" out to keep them
unavailable.free_datum (warning): no covariance: the datum is free
    -> keep the priors or measure control points
unavailable.loss (warning): no covariance: under the loss {loss} residuals near zero get weights above 1, which
    are no information
    -> adjust with another one
unavailable.indeterminate (warning): no covariance: {why}
    -> measure more control points or keep the priors
unavailable.slopes (warning): no shift: {n} points over slopes of the model, {least} are needed
unavailable.aspects (warning): no shift: the terrain has not enough slopes of different aspect to tell East and
    North
unavailable.steps (warning): no shift: it has not converged after {steps} steps
search.left_out (warning): snooping left out {n} observation(s) in {rounds} rounds: {names:5}
    + ; with them, as single rays of their points: {with_them:5}
search.conditional (note): standard deviations after the search are conditional: they hold if exactly the wrong
    observations were left out
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
absent.components (warning): not given: {figures!w}; with estimated variance components sigma0 does not test the
    model
absent.not_converged (warning): not given: {figures!w}; the adjustment did not converge
absent.covariance (warning): not given: {figures!w}; they need the covariance
absent.basic (warning): not given: {figures!w}; <statistics> is "basic"
absent.memory (warning): not given: {figures!w}; with them the adjustment would exceed the memory limit of {allowed}
    -> raise <memory_limit_gb>, or take a machine with more memory
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
    "figures": "figures of constraints",
    "us_per_observation_iteration": "the time per image point and iteration",
}  # fmt: skip
