"""Messages about an adjustment: parameters, options, backends, parts; its result and remarks."""

from __future__ import annotations

from typing import Final

from fg_orient.model.messages.entry import words

WORDS: Final = words("""
parameters.eop_set: unknown EOP set
    -> give a number or a name: {names}
parameters.unknowns: the image has none of these unknowns, so nothing can be adjusted
    -> choose one of {known}
parameters.unknown: no image of the block has an unknown of this name
    -> use the names in eop.csv, such as x_0, roll_1, psi_y_s1 or line_l1
options.value: the value of this option is not allowed
    -> give {expected}
jitter.image: there is no such image
    -> images of the block: {known}
jitter.twice: image {id} has two curves of the same angle, or curves with different numbers of intervals
    -> name each angle once, with the same number of intervals
jitter.curves: an image has either smooth curves or jitter curves
    -> leave <curve_intervals> or <jitter_curves> out
jitter.kind: an image of this kind ({kind}) has no roll and pitch
    -> name images of pushbroom sensors only
jitter.excluded: the evidence for jitter needs least squares with the prior sigmas
    -> leave <jitter> or this option out
jitter.priors: the evidence for jitter needs priors of the orientation
    -> leave <priors> on, with the datum auto, control or priors
jitter.no_angles: no image has roll or pitch with coefficients of degree 0, 1 and 2, which jitter needs
    -> choose an EOP set with the attitude, such as A or PUA
jitter.found (note): jitter was found in {angles!w}; the adjustment contains its curves (docs/jitter.md)
jitter.not_found (note): no jitter was found in {angles!w}
jitter.untold (note): it is not known whether there is jitter in {angles!w}, because too few points determine it
    -> measure more control points along the lines of the image
jitter.many: jitter is tested in at most {limit} images at once
    -> adjust parts of the block with <jitter>, then name the curves found by <jitter_curves>
initial.no_intersection: the point has no start value, because its rays are parallel within {least} degrees
    -> measure the point in another image, give it coordinates as control, or remove it
initial.seen_once: the point is seen in {image} only and has no control coordinates: it can move along its ray
    -> measure the point in another image, give it coordinates as control, or remove it
initial.pixel_count: lines and samples must have one row for each of the {sensors} sensors, of the same length
    -> give (k,) or (k, N) arrays, row k for sensor k
initial.correction_count: there must be one correction for each of the {sensors} sensors
    -> give one correction per sensor, or None for the metadata orientation
initial.behind: the rays of the point meet behind a sensor
    -> check the point's identity in every image
adjust.memory: the adjustment exceeds the memory limit of {allowed}
    -> choose backend schur if another backend is chosen, adjust in parts on several machines (docs/parallel.md), use a
       machine with more memory, or raise <memory_limit_gb>
adjust.in_parts (note): the whole block needs {value} of memory, {allowed} are allowed. The ground points are therefore
    adjusted in {parts} parts, whose arrays are in files; {kept} parts are in memory at the same time
adjust.backend: this backend does not exist in this version
    -> choose one of {known}
adjust.no_model: images of this sensor cannot be adjusted
    -> derive its class from fg_orient.Sensor and give it the method image_model (docs/extending)
adjust.vendor_datum: a block of {n} image unknowns is too large for this datum
    -> choose datum = "priors" with the vendor's location error as prior sigma
adjust.vendor_datum_points: this datum needs points that are determined by their rays: {why}
    -> measure further image points, or choose datum = "priors"
adjust.relative_priors: without control points and priors the datum of the block is not defined
    -> keep the priors, or remove the option datum and measure control points; with datum = "free" the block needs no
       datum
adjust.solver_dense: a linear solver can be chosen for the dense backend only; the backend is {backend}
    -> add <backend> dense, or leave the solver out
checkpoint.unreadable: this is not a checkpoint of this version
    -> remove the file, or leave <resume> out to start from the beginning
checkpoint.other: the checkpoint belongs to other input files or options
    -> give the options of the run that was stopped, or leave <resume> out to start from the beginning
adjust.loss: unknown robust loss
    -> choose one of {known}
adjust.gnc: graduated non-convexity needs a bounded loss
    -> choose one of {known}, or leave gnc out
adjust.needs_loss: this option needs a robust loss
    -> add <loss> tukey or another redescending loss, or leave the option out
adjust.gnc_start: graduated non-convexity begins with least squares and does not change the sigmas
    -> leave out gnc, or leave out robust_start and robust_scale
adjust.few_control: the image has too few points for a robust start by resection: control points and points that two
    oriented images see
    -> measure {least} or more of these points in the image, or choose robust_start huber
adjust.cycles: this loss has no cost function
    -> leave gnc, robust_start, robust_scale and parts out, or choose one of the losses {known}
graph.own_optimizer: this is not possible with your own optimiser
    -> leave the argument out, or name one of the program's optimisers
graph.loss: the factors of a block cannot contain a robust loss
    -> leave <loss> out, or put a loss into the noise models of your own factors
graph.no_priors: points cannot be eliminated without priors
    -> keep the priors, or choose points = "explicit"
graph.no_factor: this is neither an ExtraObservation nor a factor of GTSAM
    -> give a gtsam.NonlinearFactor, or an ExtraObservation
graph.key: this key is not a variable of the block
    -> take keys from fg.factor_graph(block).key("point:12"), or key("image:left")
graph.broken_factor: this factor cannot be evaluated: {why}
    -> check that images are vectors of their unknowns and points Point3, and that no sigma is zero
graph.name: the graph has no variable of this name
    -> give "image:ID", "shared:ID", or "point:ID" of an unknown point; eliminated points are not variables
earlier.no_start: there is no earlier result to take the prior from
    -> add <start>
earlier.no_image: the earlier result contains no image of this block; it contains {value}
    -> give a result that contains images of this block with the same ids
earlier.size: the image of the earlier result has another size; here it has {lines} x {samples} pixels
    -> give a result of the same images, or rename the image
earlier.unknowns: only one of the two adjustments has these unknowns
    -> adjust with the same EOP set and the same options of unknowns as in the earlier run
earlier.metadata: the metadata file of the image has changed since the earlier run
    -> restore the metadata file of the earlier run, because the corrections refer to it
earlier.not_converged: the earlier adjustment did not converge, so its covariance cannot be a prior
    -> leave <start_prior> out
earlier.no_covariance: the earlier result has no joint covariance ({name}). The joint covariance needs <statistics>
    "full", a datum other than "inner", and at most {limit} unknowns of images and control points
    -> adjust the earlier block again with <statistics> "full", or leave <start_prior> out
earlier.components: the covariance of the earlier result refers to the prior sigmas, so they cannot be estimated
    -> leave "priors" out of <variance_components>, or leave <start_prior> out
earlier.inner: a free network cannot use a prior of an earlier result
    -> give another <datum>, or leave <start_prior> out
earlier.check: these check points were control points of the earlier result, so they are no independent check
    -> make them control points, give a result without them, or leave <start_prior> out
earlier.shared: the id under which images share this unknown differs from the id in the earlier result
    -> give the cameras the same ids as in the earlier run
earlier.singular: the covariance of the earlier result is not positive definite
    -> leave <start_prior> out
adjust.schur: the Schur backend cannot adjust this block: {value}
    -> choose <backend> graph, or auto
adjust.rank_deficient: not observable without priors
    -> keep the priors, choose a smaller EOP set, or add <regularisation> tikhonov
adjust.rank_without_control: not observable without priors, and the block has no control point
    -> keep the priors: datum = "priors"; or choose a smaller EOP set, or add <regularisation> tikhonov
regularise.penalty: only Tikhonov's method has this penalty
    -> add <regularisation> tikhonov, or leave the penalty out
regularise.datum: a regularisation keeps the block near the metadata, so this datum is not possible
    -> leave the datum or <regularisation> out
regularise.condition: the normal equations of this rank have the condition number {condition:.1e}, above {limit:.0e},
    and lose the weakest directions
    -> choose <backend> graph or dense, or raise <rank_cut>
regularise.weak (doubt): the rank includes {n} direction(s) in which the standard deviations exceed {prior_sigmas:.0e}
    prior sigmas; the unknowns are not usable
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
regularise.rule_large: with so many image unknowns this rule is not possible, or not possible together with priors
    -> choose one of {known}, or give <kappa> a number
regularise.rule_priors: this rule is not defined together with priors, units or a penalty of this kind
    -> choose one of {known}, leave the priors out, or give <kappa> a number
adjust.extra_kind: argument {argument} of the extra observation is the wrong kind of unknown
    -> give a point as "point:12", an image as "image:left", in the order of the equation
adjust.extra_unused: the extra observation names a point that does not take part in the adjustment
    -> measure the point in two images, or let check points take part (<check_points> use)
adjust.extra_constant: the extra observation has only constant arguments, so it changes nothing
    -> name at least one point or image that is an unknown
adjust.broken_down: the normal equations cannot be solved: {why}
    -> keep the priors, choose a smaller EOP set, measure more control points, or check sigmas and start values
adjust.extra_unknown: the extra observation needs names of images or points of the block
    -> write the names as "image:left" or "point:12"
covariance.weighted: observations are not tested for gross errors under a robust loss, which has already down-weighted
    such errors
    -> check the weights, or adjust with loss none
covariance.unavailable: no covariance was computed
    -> see the warnings of the adjustment
covariance.no_such: unknown image, parameter, point or observation
    -> write the name as "image:left", "image:left.x_0", "point:12", "observation:left/12" or "residual:left/12"
covariance.not_unknown: this is not an unknown of the adjustment, so it has no covariance
    -> ask for adjusted points only
block.no_rays: no image point takes part in the adjustment
    -> measure points in at least two images; excluded check points determine nothing
block.no_control: no control point is measured in any image: the block has no datum
    -> give at least one point of role control, better six or more, well spread; or choose datum = "vendor" for a
       relative adjustment, whose accuracy is unknown
remark.sigma_ground (note): {count} point(s) have standard deviations outside {low:g} .. {high:g} m
    -> check that they are in metres
remark.sigma_image (note): {count} record(s) have standard deviations outside {low:g} .. {high:g} pixels
    -> check that they are in pixels
remark.not_measured (note): {count} point(s) are not measured in any image and are left out
    -> measure them, if they should take part
remark.seen_once (note): {count} check or tie point(s) with a single ray are left out
    -> measure them in a second image
remark.grid_missing (note): a more accurate coordinate operation exists; the operation used is accurate to {accuracy}
    -> install {grids} (projsync) if you need more accuracy
remark.few_control (note): only {count} control point(s) are measured
    -> use six or more, well spread: errors of control points are found only with redundancy
remark.control_line (note): the control points lie close to a line: {across_m:.0f} m wide, {along_m:.0f} m long
    -> add control points off the line; until then the priors dominate roll and pitch
remark.control_clustered (note): the control points of image {image} cover only {lines:.0%} of its lines and
    {samples:.0%} of its samples
    -> add control points in the rest of the image
remark.control_one_image (note): control points are measured in image {image} only
    -> measure control points in the other images, too
remark.few_check (note): only {count} check point(s) are given, fewer than the 30 that ASPRS (2023) requires: the
    accuracy figures are uncertain
    -> add check points if you can
options.two_ways: these options exclude each other
    -> give only one of {option}
parallel.number: this number is not possible
    -> give a whole number from {low} to {high}
parallel.kind: this kind of value is not possible
    -> give {expected}
parallel.parts: the {points} ground points cannot be divided into this number of parts
    -> give a number from 1 to {points}, or leave it out
parallel.no_parts: a work folder is for a block in parts, and this block is not divided
    -> give parts, workers or a scheduler, or leave the work folder out
parallel.backend: parts are adjusted by the Schur backend, not by {value}
    -> leave the backend out, or adjust without parts and workers
parallel.dask: several workers need dask and cryptography, which are not installed
    -> pip install "fg-orient[cluster]", or one worker
parallel.unreachable: no scheduler answers at this address
    -> start dask scheduler and workers, see docs/parallel.md
parallel.folder: a worker cannot read a file of the work folder
    -> give a folder that has the same name for all workers (<work_dir>)
parallel.version: the worker has another version of fg_orient than {written}
    -> install the same version everywhere: results must not depend on the worker
parallel.killed: several workers ended while they computed the same part
    -> check the memory of the workers: use fewer workers, or more parts (a checkpoint needs the same parts)
parallel.replaced: worker processes ended again and again, so they are no longer replaced
    -> check their memory, and find out why they end; use fewer workers; then continue with <resume>
parallel.start: worker processes ended while they started, {count} times
    -> check memory and the limit of processes, or use fewer workers
parallel.lost: the cluster has ended or no longer answers
    -> check its scheduler; then continue with <resume>
parallel.result: this file of an earlier run cannot be read
    -> remove it; its case is then computed again
loop.small_step (note): the scaled step is below the tolerance
loop.small_step_damped (note): Gauss-Newton raised the cost and Levenberg-Marquardt continued; the scaled step is below
    the tolerance
loop.given (note): the whitened gradient is near zero at the given values
loop.gradient_left: the optimiser ended too early: the next Gauss-Newton step would be {step:.1e}, which is
    {gradient:.1e} standard deviations
    -> try <optimizer> levenberg-marquardt, or search for gross errors
loop.step_left: the optimiser ended too early: the next Gauss-Newton step would be {step:.1e}
    -> search for gross errors, and check the start values
loop.error_rises: the weighted sum of squares increases
    -> try <optimizer> levenberg-marquardt
loop.last_step: the last step increased the weighted sum of squares
    -> try <optimizer> levenberg-marquardt
loop.no_step: no step decreases the weighted sum of squares
    -> search for gross errors, and check the start values
loop.iterations: no convergence within {iterations} iteration(s)
    -> raise <max_iterations>, or check the start values
loop.weights: the weights have not converged within {cycles} cycles
    -> choose another loss
loop.free_datum: the iteration does not reach the datum of the free network
    -> check the start values
loop.interrupted: interrupted after iteration {iteration}; its values are saved in {kept}
    -> continue from there with <resume>
verdict.free_datum (doubt): the datum is free: position, orientation and scale of the block come from the start values;
    only its shape is determined
verdict.weak_control (doubt): without priors the control points determine some directions too weakly for a
    covariance: coordinates must not be trusted
verdict.sigma0 (doubt): sigma0 = {size:.3f} lies above {limit:.3f}, the upper end of its 99.9 % interval: the
    observations do not fit the model within their sigmas. The model lacks unknowns for the errors present, or the
    sigmas are too small, or there are gross errors. Standard deviations and coordinates must not be trusted
verdict.sigma0_regularised (doubt): sigma0 = {size:.3f} lies above {limit:.3f}, the upper end of its 99.9 % interval;
    {share:.0%} of the weighted sum of squares comes from the penalty. If this is a large part, kappa is too large for
    the deviations from the metadata; else the observations do not fit the model within their sigmas
    -> give a smaller <kappa> or another <kappa_rule>; search for gross errors
verdict.gross_error (doubt): gross error suspected
    + , of about {error} {unit}
    + ; {symbol} = {size:.1f}; fewer than {level:g} % of blocks without gross errors have such a large value
    + ; without this observation sigma0 is {without:.2f}, inside its interval
    + ; the error may also be in {also:5}, which cannot be separated from it
    + ; {more} more observation(s) are suspicious, perhaps because of this error
    + ; among them are {crowd}: the measurements or the orientation of this image are wrong
    -> correct the measurement or the coordinates, search with <snoop>, or accept the doubt with <accept>
       "gross_error:{place}"
verdict.sigmas (doubt): the stated standard deviations are too small: {words}; if they were right, fewer than {level:g}
    % of blocks would have such large residuals. Standard deviations and coordinates must not be trusted
    + ; the standard deviations of {more} are too small, too
    -> correct them, let <variance_components> estimate them, or accept the doubt with <accept>
       "sigmas:{place}<={size:up3}"
verdict.sigmas_large (note): the stated standard deviations are too large: {words}; the observations have too little
    weight, and the result looks less accurate than it is
    -> correct them, or let <variance_components> estimate them
verdict.beyond_prior (doubt): the adjusted value differs by {correction:+.3g} {unit} from the metadata, {size:.1f}
    times the standard deviation of this difference; the prior standard deviation is {sigma:.3g} {unit}
    + ; this difference is too large for {more} more unknown(s), too
    -> check for wrong metadata, exchanged images or wrong control points, give a larger prior standard deviation if
       the metadata can have this error, or accept the doubt with <accept> "beyond_prior:{place}"
verdict.accuracy (doubt): {n} of {of} points have a standard deviation above the required {required:g} m; the largest
    is {size:.3g} m: {points:10}
    -> add control points or images, or accept the doubt with <accept> "accuracy<={size:up3}"
verdict.accuracy_unknown (doubt): the required accuracy of {required:g} m is not verified, because there is no
    covariance
verdict.check_far (doubt): check points contradict the adjusted points: {points:10}; the largest difference is
    {size:.1f} times its standard deviation; the limit for {n} coordinates is {limit:.1f}
    -> check the coordinates and image points of these points, or accept the doubt with <accept>
       "check_far<={size:up3}"
verdict.check_beyond (doubt): check points contradict the adjusted points: {size} of {n} check coordinates differ by
    more than 3 standard deviations of the difference, {expected:.1f} are expected. According to their joint covariance,
    fewer than {level:g} % of blocks without mistakes have so many such coordinates: {points:10}
    -> compare datum, heights and sigmas of control and check points, or accept the doubt with <accept>
       "check_beyond<={size}"
verdict.cause (note): likely cause: {what}; twice the logarithm of its likelihood ratio to a block without mistakes:
    {gain:.1f}
    + ; without it sigma0 {before} -> {after}, and {left}
    + ; cannot be distinguished from: {also}
    -> {cure}
verdict.accepted (note): accepted by <accept>: {names:10}
verdict.loss (doubt): {down} of {n} image points have a weight below {limit}: the model is wrong, or the sigmas are too
    small
verdict.loss_of_images (doubt): most image points of {count} image(s) have a weight below {limit} ({images:10}): their
    orientation depends on the other image points and on the priors. The metadata, the point numbers or most control
    points there are wrong
verdict.no_redundancy (warning): no redundancy: nothing was checked
verdict.components (warning): sigma0 does not test the model: the sigmas were estimated from these residuals, which
    brings sigma0 near 1
weights.beyond (warning): robust loss {loss}: the residuals of {down} of {n} image points and {control} control points
    exceed {limit:g} sigmas. The weights of this loss decrease for all residuals, however small, so no observation
    counts as down-weighted, and sigma0 does not test the sigmas
weights.below (warning): robust loss {loss}: {down} of {n} image points and {control} control points have a weight
    below {limit}
    + ; the unit of the loss is {scale_image:.2f} sigmas of image points and {scale_control:.2f} sigmas of control
      points
    + ; chi2, sigma0 and standard deviations (prior scale) use the weights at the solution as given values, and sigma0
      is not tested
weights.no_ray (warning): the loss has down-weighted all rays of {n} point(s), so nothing checks their coordinates:
    {points:10}
    + ; check points among them: {check:10}
weights.one_ray (warning): the loss has down-weighted all rays but one of {n} point(s), so nothing fixes them along
    this ray: {points:10}
    + ; check points among them: {check:10}
solution.sigmas_large (warning): sigma0 lies below {limit:.2f}, the lower end of its 99.9 % interval: the sigmas are
    too large, and so are the standard deviations in prior scale
solution.weak_directions (warning): without priors {n} direction(s) of the block are determined 100 times worse than by
    their prior sigmas: results along these directions are not reliable
solution.relative (warning): relative adjustment: no control point determines the position of the block. The block
    moved by {moved_m[0]:+.1f}, {moved_m[1]:+.1f}, {moved_m[2]:+.1f} m {axes}, and with the metadata orientation the
    rays of a point miss each other by {disagreement_m:.2f} m (RMS). No standard deviation of the result is an accuracy
    -> datum = "vendor" fixes the directions that the rays hardly determine; measure control points to get an accuracy
solution.vendor_datum (note): {n} directions of the images that the rays hardly determine are held at the metadata;
    standard deviations are relative. According to the prior sigmas the whole block has a standard deviation of
    {east:.3g}, {north:.3g}, {up:.3g} m East, North, Up along these directions
solution.motions (warning): {direction}
    -> {remedy}
solution.motions_inner (warning): {direction}; inner constraints on the ground points fix these motions: standard
    deviations are relative
solution.parts (warning): the block falls into {n} parts that no point links: {parts}
    -> measure points in images of two parts
solution.singular (warning): the normal equations are ill-conditioned: to working precision they are singular
solution.ill_conditioned (warning): the normal equations are ill-conditioned (condition {condition:.0e} with scaled
    unknowns, the limit is {limit:.0e}): solvers agree to about {digits} digits of the image unknowns only
solution.unobservable (warning): {n} orientation direction(s) are not observable and are held by {holder}
    alone
solution.unobservable_image (warning): {summary}
solution.look_angles (warning): the constant and linear look-angle terms nearly duplicate roll, pitch and yaw: assess
    their sum, not the single terms
solution.outside_validity (warning): {n} point(s) lie outside the validity range of the model of image {image}:
    {points:10}
solution.no_check (warning): no check points: the accuracy is not verified independently
solution.wide_factor (note): the points link the images in such a way that GTSAM eliminates {n} unknowns together,
    which takes about {seconds:.1f} s per iteration
    -> choose backend schur: it solves the same equations by LAPACK in less time
solution.few_check (warning): only {n} check point(s) are given; ASPRS (2023) requires at least {least}
solution.check_not_located (warning): {n} excluded check point(s) have no coordinates, because their rays do not
    determine them: {points:10}
solution.mix_up (doubt): image {image}: with {reading} the median misclosure of {n} of its {of} control points is
    {best_px:.3g} px; with the data as given it is {given_px:.3g} px
    + ; with this, sigma0 {before} -> {after}, and {left}
    -> check the columns of the table and the metadata file of the image
solution.id_mix_up (doubt): {what}; their median misclosure is then {best_px:.3g} px; with the data as given it is
    {given_px:.3g} px
    + ; with this, sigma0 {before} -> {after}, and {left}
    -> give the right ids in the tables of points and image points
solution.id_copied (doubt): it has the coordinates of control point {other}, and its image points lie {given_px:.3g} px
    from there (median): the table contains one control point under two ids
    + ; without its coordinates, sigma0 {before} -> {after}, and {left}
    -> give the coordinates of this point
solution.no_inner_datum (warning): the control points define the datum, so inner constraints have no effect
    -> leave datum = "inner" out
solution.no_inner_datum_nor_priors (warning): the control points define the datum, so inner constraints have no effect;
    the priors of the images were still switched off
    -> leave datum = "inner" out to keep the priors
unavailable.free_datum (warning): no covariance: the datum is free
    -> keep the priors or measure control points
unavailable.loss (warning): no covariance: under the loss {loss} residuals near zero get weights above 1, which contain
    no information
    -> adjust with another loss
unavailable.indeterminate (warning): no covariance: {why}
    -> measure more control points or keep the priors
unavailable.slopes (warning): the shift is not estimated: {n} points lie on slopes of the elevation model, {least} are
    needed
unavailable.aspects (warning): the shift is not estimated: the terrain has too few slopes of different aspect to
    separate East and North
unavailable.steps (warning): the shift is not estimated: the computation has not converged after {steps} steps
search.restless: the rejection by the median does not converge: the rejected image points change after each of {value}
    iterations
    -> raise <median_rejection> or <max_iterations>, or search with <snoop>
search.left_out (warning): snooping left out {n} observation(s) in {rounds} rounds: {names:5}
    + ; all three coordinates of a point are left out together, so these control points are tie points now: {ties:5}
    + ; also left out, as the only remaining rays of their points: {with_them:5}
search.conditional (note): standard deviations after the search are conditional: they are valid if exactly the wrong
    observations were left out
search.check_points (warning): {n} check point(s) are not used for the accuracy, because snooping left them fewer than
    two rays: {points:5}
search.not_converged (warning): the adjustment does not converge
search.too_many (warning): {percent:.0f} % of the image points are left out and more are suspicious: the model or the
    sigmas are wrong, not the image points
search.impossible (warning): without {name}, the most suspicious observation, the block cannot be adjusted: {why}
components.held (warning): variance component of {group} is held at the given sigma: {why}
components.lower_bounds (warning): standard deviations of variance components are lower bounds: there are too many
    image unknowns and groups to compute the covariances between groups. Outlier tests use the degrees of freedom of
    each observation's own group, which gives too many false alarms (at least one in 18 % of simulated blocks instead
    of 5 %)
absent.no_redundancy (warning): not given: {figures!w}; there is no redundancy, and standard deviations are in prior
    scale
absent.no_unit_weight (warning): not given: {figures!w}; there is no redundancy
absent.loss (warning): not given: {figures!w}; the weights of the loss change them
absent.loss_but_redundancy (warning): not given: {figures!w}; the weights of the loss change them; residuals.csv
    contains the redundancy numbers
absent.components (warning): not given: {figures!w}; with estimated variance components sigma0 does not test the
    model
absent.not_converged (warning): not given: {figures!w}; the adjustment did not converge
absent.covariance (warning): not given: {figures!w}; they need the covariance
absent.basic (warning): not given: {figures!w}; <statistics> is "basic"
absent.memory (warning): not given: {figures!w}; with them the adjustment would exceed the memory limit of {allowed}
    -> raise <memory_limit_gb>, or use a machine with more memory
absent.large (warning): not given: {figures!w}; the block has more than {limit} image points, or too many image
    unknowns
    -> request them with <statistics> "full"
absent.whole_block (warning): not given: {figures!w}; the block is too large to be decomposed as a whole
absent.no_iteration (warning): not given: {figures!w}; there was no iteration
absent.nothing_adjusted (warning): not given: {figures!w}; nothing was adjusted
record.sentence (warning): {text}
""")

#: Descriptions of a record's figures; any other figure is described by its key, with spaces.
figures_in_words: Final = {
    "sigma0_interval_99_9": "the interval of sigma0", "global_test": "the global test",
    "outlier_tests": "tests of single observations", "suspicious_observations": "suspicious observations",
    "reliability": "redundancy numbers and minimal detectable biases",
    "correlations": "correlations of the orientation", "block_observability": "directions of the whole block",
    "figures": "figures of constraints",
    "us_per_observation_iteration": "the time per image point and iteration",
}  # fmt: skip
