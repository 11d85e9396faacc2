"""Messages about the work itself: parameters, options, adjustment, outputs, commands; remarks."""

from __future__ import annotations

from typing import Final

from fg_orient.model.messages.entry import words

WORDS: Final = words("""
parameters.eop_set: no such EOP set
    -> give a number or a name: {names}
parameters.unknowns: none of these unknowns is one of this image, which would have nothing to adjust
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
adjust.memory: the adjustment needs more memory than it may take, which is {allowed}
    -> choose backend schur if it is another one, adjust in parts on several machines (docs/parallel.md), take a
       machine with more memory, or raise <memory_limit_gb>
adjust.backend: this backend does not exist in this version
    -> choose one of {known}
adjust.no_model: images of this sensor cannot be adjusted
    -> known sensors: {known}; a further one is registered by a file of its own (docs/extending)
adjust.relative_priors: without control points and without priors nothing holds the block in the world
    -> keep the priors, or leave out datum = "priors" and measure control points; datum = "free" lets the block
       float
adjust.native_dense: GTSAM's own optimisers work on the graph only
    -> choose one of {known}, or the graph backend
adjust.solver_dense: a linear solver can be chosen for the dense backend only; the backend is {backend}
    -> add <backend> dense, or leave the solver out
checkpoint.unreadable: this is no checkpoint of this version
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
adjust.cycles: this weighting has no cost: it is an iteration of its own
    -> leave gnc, robust_start, robust_scale and parts out, or choose a loss among {known}
adjust.native_loss: GTSAM's own optimisers are offered for least squares only
    -> use <optimizer> gauss-newton, levenberg-marquardt or dogleg
adjust.schur: the Schur backend cannot take this block: {value}
    -> choose <backend> graph, or auto
adjust.native_limit: GTSAM's own optimisers copy all values at each callback of a Python factor and are refused
    above {limit} image points; the block has {count}
    -> use <optimizer> gauss-newton, levenberg-marquardt or dogleg (the same linear algebra, driven from Python)
adjust.rank_deficient: not observable without priors
    -> keep the priors or choose a smaller EOP set
adjust.rank_without_control: not observable without priors, and the block has no control point
    -> keep the priors: datum = "priors"; or choose a smaller EOP set
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
covariance.withheld: no covariance was computed
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
    -> give at least one point of role control, better six or more well spread; or datum = "priors" for a relative
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
    -> add control beside the line: roll and pitch lean on the priors
remark.control_clustered (note): the control points of image {image} cover only {lines:.0%} of its lines and
    {samples:.0%} of its samples
    -> add control in the rest of the image
remark.control_one_image (note): control points are measured in image {image} only
    -> measure control in the other images, too
remark.few_check (note): {count} check points: fewer than the 30 of ASPRS 2023, the accuracy figures are uncertain
    -> add check points if you can
output.exists: the output exists already
    -> give another {option} or add <overwrite>
output.not_a_folder: this is no folder, or a link to one
    -> give another <out>
output.foreign: the folder holds other files, so it is not replaced
    -> give another <out>, or move them; <overwrite> replaces only a folder with {mark} and nothing of others
output.unwritable: the file cannot be written
    -> check folder, permissions and free space
replay.record: the result does not say how to repeat its run
    -> it is damaged or of an older version: run fg-orient adjust again
replay.project: the project file of this result is not in the folder above it
    -> give it: <project> FOLDER/{name}
replay.dem: the elevation model of this run is not in the project's folder
    -> put it there, or a link to it
replay.changed: the file has changed since the run: SHA-256 {now}, recorded {then}
    -> bring back the file of the run, or add <allow_changed> to go on with this one
replay.missing: the run read this file, and now it is missing or no longer named by the project
    -> bring it back, or add <allow_changed> to go on without it
replay.new: the run did not read this file
    -> bring back the project of the run, or add <allow_changed> to go on with it
replay.same_folder: the repeated run would replace the result that it repeats
    -> give another <out>
internal: error of the program: {kind}: {text}
    -> please report it{hint}
plugin.file: there is no such Python file
    -> give a file such as my_sensor.py, its name being a module's name
plugin.name: another module has this name already
    -> rename the file
plugin.raised: the plugin raised an exception
    -> mend it there; what is wrong with a file it should say by an InputError; <debug> shows the traceback
plugin.failed: the plugin cannot be loaded
    -> mend the file; from Python, import it to see more
cli.no_pixel: no pixel is given
    -> give <line> L <sample> S, or <points> FILE, or <frame>
cli.no_height: no height to locate at
    -> give <height> H (m, ellipsoidal) or <dem> FILE, or a column height_m in the points file
cli.height_range: the height is outside {low:g} .. {high:g} m
    -> give an ellipsoidal height in m
cli.two_heights: the height is given twice
    -> give only one of <height>, <dem> and a column height_m
options.two_ways: these options exclude each other
    -> give only one of {option}
cli.two_ways: these options exclude each other
    -> give only one of {options}
cli.no_ground: no ground point is given
    -> give <lon>, <lat> and <height>, or <points> FILE
cli.pixel: this is no pixel
    -> write <pixel> LINE,SAMPLE, for instance <pixel> 5999.5,120
cli.pixel_count: {pixels} pixel(s) for {images} image(s)
    -> give one <pixel> per image, in order
cli.one_image: an intersection needs two images
    -> give several metadata files, or one project file (.toml)
cli.one_project: one project file is checked at a time
    -> check one after the other; for several files of points add <format> NAME
cli.no_frame: the file states no frame points of its own
    -> locate a pixel with <line> and <sample>
log.foreign: the file is no log of fg-orient, so nothing is added to it
    -> give <log> the name of a new file, or of a log that fg-orient wrote
cli.shell: completion is not written for this shell
    -> choose one of {known}
cli.usage: {text}
    -> see the command's <help>
report.no_result: the folder holds no result of an adjustment
    -> give a folder that fg-orient adjust wrote
report.nothing_adjusted: nothing was adjusted, so there are neither coordinates nor an orientation
    -> report.html in the folder names what was not determined and the way out
report.damaged: the result cannot be read
    -> run fg-orient adjust again
report.no_matplotlib: figures need matplotlib
    -> install the extra: pip install 'fg-orient[report]'
report.no_map: the result has no geographic coordinates
    -> layers need a block on the Earth
report.no_pyogrio: a GeoPackage needs pyogrio and shapely
    -> install the extra: pip install 'fg-orient[geo]', or give a .geojson
report.export_suffix: this file is neither GeoPackage nor GeoJSON
    -> end its name with .gpkg or .geojson
report.no_truth: the folder holds no truth of a simulation
    -> give the folder truth of fg-orient simulate
report.other_truth: the truth belongs to another project
    -> give the truth of these images and points
""")
