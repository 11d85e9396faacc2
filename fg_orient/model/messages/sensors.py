"""Messages about sensor descriptions, frame cameras, bundle files, navigation and RPC."""

from __future__ import annotations

from typing import Final

from fg_orient.model.messages.entry import words

WORDS: Final = words("""
earth.span: the Earth orientation series covers MJD {first:.0f} .. {last:.0f} only
    -> use a C04 file that covers the image, or leave it out: UT1 = UTC then
earth.missing: orbit or attitudes are inertial, but nothing says how the Earth stands in these axes
    -> add the table [earth] to the description; in Python give the sensor an EarthRotation
earth.list_span: the list of table [{what}] covers {first:.6f} .. {last:.6f} s of the day only and is never
    extrapolated
    -> give states that cover all lines
earth.unreadable: the Earth orientation file cannot be read
    -> check the path and its permissions
earth.no_records: no records of an IERS C04 series
    -> give a C04 file with at least two days: year, month, day, MJD, x, y, UT1-UTC, ...
earth.record: this record is not one of an IERS C04 series
earth.gap: days of the series do not follow each other
    -> use the file as the IERS gives it out
earth.value: a pole coordinate beyond 1 arc second or UT1 - UTC beyond 1 s cannot be right
    -> check the units: arc seconds and seconds
earth.day: this is no day
    -> write it as "2012-01-01"
earth.period: the line period is zero or not finite
    -> give the seconds from one line to the next, below zero if time runs back
earth.camera: a camera is either a lens or a table of directions
    -> give focal_length_m, pitch_m and principal_sample, or directions alone
earth.directions: directions must cover samples 0 to {last}
    -> add the missing ones
earth.wide: the camera looks farther than a tangent of {most} from its axis
    -> check units and signs, or turn the axis by [mounting]
earth.matrix: the matrix is not a rotation, or angles are given too
    -> give either angles_deg or an orthonormal right-handed matrix
earth.order: the values must increase, and two at least are needed
    -> sort the table, remove repeated records
earth.state: the {what} must be {low:g} .. {high:g}
    -> check unit and frame (m, m/s)
earth.quaternion: a quaternion must have norm 1 within 1e-4
    -> give the scalar part first, as q0
earth.two_frames: orbit and attitudes stand in two inertial frames
    -> bring them to one
earth.seconds: times must be seconds since 0 h UTC of the day of the image
    -> subtract the day
frame.camera: this value of the camera is not possible
    -> give {expected}
metashape.sensors: the file must have one sensor with an adjusted calibration
    -> export the cameras of one sensor
metashape.kind: only the calibration of a frame camera is read
    -> give type = "frame"
metashape.size: width and height must be whole numbers from 1 to 1000000
metashape.params: these are not the names of calibration values, each once
    -> give some of f cx cy b1 b2 k1 k2 k3 k4 p1 p2
frame.unknown: the camera has no such unknown, or its prior sigma is not above zero
rpc.unknown_order: no such order of coefficients
rpc.unknown_format: this is no RPC file that can be read
rpc.target_name: no such format to write
rpc.compensation_kind: no such compensation
rfm.denominators: no such denominators
rfm.selector: no such selection of coefficients
    -> choose one of {known}
frame.nothing_unknown: the camera has no unknown, so its image cannot be adjusted
    -> name some with their prior sigmas, small ones to hold it
frame.shared: images that share the unknown under {id!r} disagree
    -> give all of them the same prior sigma and the same start value
frame.shared_not: images have unknowns in common ({id}), which this cannot do
    -> leave it out, or let each image have its unknowns for itself
frame.no_direction: the distortion of the camera cannot be inverted at this pixel
    -> check k1, k2, k3, p1, p2: the polynomial folds inside the image
frame.local: the image stands in a local coordinate system: there is no height above the ellipsoid to locate at
    -> intersect the point from two images, or give the camera in Earth-fixed coordinates
bal.unreadable: the bundle file cannot be read
    -> give a text file, plain or compressed by gzip or bzip2
bal.header: a bundle file begins with three counts: cameras, points, observations
    -> check that this is a file of Bundle Adjustment in the Large
bal.count: the counts of the first line ask for {expected} numbers in all
    -> the file is truncated or damaged: copy it again
bal.number: this is no finite number
    -> the file is damaged: copy it again
bal.index: no such camera or point
    -> cameras and points are counted from 0, here to {last}
bal.focal: the focal length is not above zero
    -> the file is damaged, or of another camera model
frame.angles: a frame image has either the angles of its camera or a rotation matrix
    -> give omega_phi_kappa_deg or rotation, and not both
sensor.toml: a sensor description or frame image must say what it is
    -> give kind = {known}
navigation.image: the project has no such image
    -> name the images as the project does
navigation.twice: the image was observed twice on board
    -> keep one record for each image
navigation.sigma: the standard deviation is not above zero
    -> give metres or degrees, as the column says
navigation.kind: only frame images in Earth-fixed coordinates take observations from on board
    -> leave the image out of the navigation table
frame.mixed: images in a local coordinate system and Earth-fixed ones cannot stand in one block
    -> transform them to one system
rpc.shape: the array must have the shape {shape}
    -> give 5 offsets, 5 scales and 4 x 20 coefficients
rpc.not_finite: a value is not finite
rpc.coefficient_count: needs 20 coefficients, {count} given
    -> use the original file
rpc.zero_scale: a scale of zero
    -> use the original file; a scale is half the range of its coordinate
rpc.denominator_constant: the constant of a denominator must be 1
    -> divide all 40 coefficients of this coordinate by it
rpc.pole: the denominator is not positive everywhere inside the image: the model fails near there
    -> fit it again with fewer or regularised coefficients; in Python RpcSensor(model, poles=True) takes it as it is
rpc.outside: the point lies outside the validity range of the model
    -> valid: longitude {lon}, latitude {lat}, height {height} m; check the order of the coordinates
rpc.no_direct: the file holds no coefficients from image to ground
    -> use locate(), which inverts the projection by iteration
rpc.no_ground: the pixel has no ground point at this height
    -> the model is valid for heights of {height} m (ellipsoidal)
rpc.compensation: compensation needs {count} finite numbers
    -> give pixels: shift, drift with the line, drift with the sample, each of line and sample
rpc.list_count: a list of RPC holds 90 numbers
    -> give 5 offsets, 5 scales (line, sample, latitude, longitude, height) and 4 x 20 coefficients
rpc.missing: {field} is missing
    -> use the complete RPC file of the product
rpc.doubled: {field} is given twice
    -> remove the wrong one
rpc.not_a_number: not a plain finite number
    -> write it as 123.456 or 1.23e-4, with a decimal point
rpc.syntax: the line cannot be understood
    -> write {expected}
rpc.order: the coefficients are in the order {found}, not {asked}
    -> if the file is right, say so: <order> {found}, or read_rpc(path, order='{found}')
rpc.origin: a plain list of numbers does not say which pixel coordinate the first pixel has
    -> say it: <first_pixel> 0, or 1 for Pléiades; in Python read_rpc(path, first_pixel=0)
rpc.no_tags: the image holds no RPC
    -> give the RPC file of the image
rpc.no_rasterio: RPC in images need rasterio
    -> install the extra: pip install 'fg-orient[geo]'
rpc.unreadable: the file cannot be read
    -> give a readable file
rpc.tags_target: RPC tags are written into an existing GeoTIFF
    -> give the image itself, or a name that ends with _RPC.TXT, .RPB or .XML
rpc.sidecar: an RPC file next to the image would hide its tags: GDAL prefers the file
    -> move it away, or write it instead of the tags
rpc.heights: this is no range of heights
    -> give the lower and the higher one, m above the ellipsoid
rpc.no_overlap: the two models see no common part of the image
    -> lines and samples of the checked one run from {mine}; compare models of one image
rpc.few_control: too few control points for this compensation
    -> it needs {least}; measure more, or take a simpler one
rpc.control_spread: the control points do not determine this compensation
    -> they lie on one line of the image: measure others off the line, or take a simpler one
rpc.solver_form: a solver is chosen for the linear form only
    -> add <equations> linear
rpc.unscaled: coefficients without normalisation are not written: formats state their ranges by offset and scale
    -> leave out <out> or <no_normalise>
rpc.no_heights: a fit to a sensor needs heights
    -> give <heights> LOW HIGH, m above the ellipsoid
rpc.foreign_option: {option} does not apply to {source}
    -> leave it out
rpc.target: the name does not say in which format to write
    -> end it with _RPC.TXT, .RPB, .XML or .TIF
rpc.image_size: the image has not the {lines} x {samples} pixels of the RPC
    -> give the image to which the RPC belongs
handover.program: no such program
    -> give one of: {known}
handover.no_target: a result folder has several RPC: nothing says for which program or in which format
    -> give <for> gdal, qgis, otb, asp, cars or s2p, or <to> and a format
handover.no_rpc: no image of the result has an RPC
    -> fit one: fg-orient rpc fit METADATA <result> RESULT <heights> LOW HIGH
handover.no_image: no RPC image has this id
    -> give one of: {known}
handover.image_words: this says not to which image the raster belongs
    -> write ID=FILE
handover.needs_image: the format {format} is a raster: it needs the image
    -> give it by <image>
handover.names: two images would get files of the same name
    -> give rasters of different names
handover.rigorous (warning): the image has a rigorous model and no RPC: nothing is written for it
    -> fit one: fg-orient rpc fit METADATA <result> RESULT <heights> LOW HIGH
handover.doubt (doubt): the adjustment ended not trustworthy
    -> read its findings before the RPC are used
handover.adjust (note): with the vendor's RPC, bundle_adjust_prefix of ASP: largest difference {most_px:.2g} px; in
    the name, adjust is the prefix, then follows the name of the image
handover.no_translation (warning): no .adjust file: the compensation is no translation of the camera, the nearest one
    differs by up to {most_px:.2g} px, above {limit:g}
    -> use the RPB, which holds the compensation
rpc.pole_inside (doubt): a denominator is not positive everywhere inside the image: {where}
rpc.near_zero_inside (doubt): a denominator comes near zero inside the image: {least:.3g}
rpc.near_zero (doubt): a denominator comes near zero: {least:.3g}
rpc.pixels_without_ground (doubt): {n} of {pixels} pixels have no ground point at their height
rpc.directions_disagree (doubt): the file's models to the ground and to the image disagree by up to {largest_px:.1f}
    px
rpc.points_outside (doubt): {n} point(s) outside the validity range: {points:5}
rpc.extrapolated (warning): the {coordinate} is extrapolated: {used:.2f} of the model's range is used
rpc.heights_beyond (warning): heights beyond the validity range {low:g} .. {high:g} m
rpc.too_many_left_out (doubt): {n} control points were left out and more are suspicious: too many for gross errors
    -> take another compensation, or check coordinates, heights and order of the file
rpc.no_fit (doubt): sigma0 is {sigma0:.1f}: the points do not fit the model
    -> is it the RPC of this image, and do its pixels and heights mean what they should?
rpc.gross_error (warning): point {point}: gross error of about {line_px:+.2f} px in line, {sample_px:+.2f} px in
    sample; F = {statistic:.1f}, limit {limit:.1f}
rpc.no_redundancy (warning): no redundancy: standard deviations are null and gross errors cannot be found
rpc.heights_system (warning): misclosures change with the height by {line:+.1f} (line), {sample:+.1f} (sample) px
    per 1000 m: a wrong height system, or the RPC of another image?
rpc.check_points (warning): check points that do not fit: {points:40}
rpc.sign_change (doubt): a denominator changes its sign among the points (least {least:.3g}): the model fails near
    there
rpc.near_zero_among (doubt): a denominator comes near zero among the points: {least:.3g}
rpc.linear_m0 (doubt): m0 of the linear form, {linear_px:.2f} px, is not the accuracy of the image: {true_px:.2f} px
rpc.not_validated (doubt): too few points to leave some out: nothing says how good the model is between them
rpc.folds_failed (doubt): {failed} of {folds} folds have no solution
rpc.overfitted (doubt): at points left out the RMS is {left_out_px[0]:.2f}, {left_out_px[1]:.2f} px (line, sample),
    in the fit {fit_px[0]:.2f}, {fit_px[1]:.2f}: more coefficients than the points carry
rpc.of_solver (warning): {note}
rfm.points: control points need finite lines and samples (n,) and ground coordinates (n, 3)
    -> give one row per point; ground: longitude, latitude (degrees), height (m)
rfm.flat: all points have the same value of this coordinate: it cannot be normalised, nor its coefficients found
    -> measure points that differ in it, or take a lower degree without it
rfm.degree: the degree of a rational function model is 1, 2 or 3
    -> give one of them
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
rfm.grid: the virtual grid needs at least {least} values per axis
    -> take more lines, samples or layers
rfm.heights: the lowest height has to lie below the highest
    -> give the lowest first, then the highest, in m above the ellipsoid
rfm.data: the file must hold rows of id, line, sample, latitude, longitude (degrees), height (m)
    -> give the file of control points of the SPOT-6 scene, or its folder
""")
