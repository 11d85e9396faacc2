"""Messages about sensor descriptions, frame cameras, bundle files, navigation and RPC."""

from __future__ import annotations

from typing import Final

from fg_orient.model.messages.entry import words

WORDS: Final = words("""
lines.vertices: a straight line has two vertices, a spline three or more
    -> divide a broken line into straight lines, or set kind to spline
lines.equal_vertices: two vertices in sequence have the same place
    -> leave one of them out
lines.sigma: standard deviations must be above 0
    -> give sigma_across_m and sigma_up_m
lines.steep: a feature near the vertical needs equal standard deviations
    -> give sigma_up_m the value of sigma_across_m
lines.unequal: the rows of a feature have different kinds or standard deviations
    -> give all rows of a feature the same ones
lines.kind: the kind of a feature must be one of {known}, and its geometry a line with Z
    -> correct the kind, or leave it out for a straight line
lines.feature: there is no such feature
    -> features of the file: {known}
lines.image: there is no such image
    -> images of the block: {known}
lines.taken: a ground point has the name of an image point on a feature
    -> give the feature another name
earth.span: the Earth orientation series covers MJD {first:.0f} .. {last:.0f} only
    -> use a C04 file that covers the image, or leave it out (then UT1 = UTC)
earth.missing: orbit or attitudes are inertial, but the rotation of the Earth to these axes is missing
    -> add the table [earth] to the description; in Python give the sensor an EarthRotation
earth.list_span: the list of table [{what}] covers {first:.6f} .. {last:.6f} s of the day only and is never
    extrapolated
    -> give states that cover all lines
earth.unreadable: the Earth orientation file cannot be read
    -> check the path and its permissions
earth.no_records: the file contains no records of an IERS C04 series
    -> give a C04 file with at least two days: year, month, day, MJD, x, y, UT1-UTC, ...
earth.record: this is not a record of an IERS C04 series
earth.gap: days of the series do not follow each other
    -> use the unchanged file of the IERS
earth.value: a pole coordinate above 1 arc second or UT1 - UTC above 1 s cannot be right
    -> check the units: arc seconds and seconds
earth.day: this is not a date
    -> write it as "2012-01-01"
earth.period: the line period is zero or not finite
    -> give the seconds from one line to the next, below zero if time runs back
earth.camera: a camera is either a lens or a table of directions
    -> give focal_length_m, pitch_m and principal_sample, or directions alone
earth.directions: directions must cover samples 0 to {last}
    -> add the missing ones
earth.wide: the directions of the camera have tangents above {most} from its axis
    -> check units and signs, or rotate the axis by [mounting]
earth.matrix: the matrix is not a rotation, or angles are given too
    -> give either angles_deg or an orthonormal right-handed matrix
earth.order: at least two values are needed, and the values must increase
    -> sort the table, remove repeated records
earth.state: the {what} must be {low:g} .. {high:g}
    -> check unit and frame (m, m/s)
earth.quaternion: a quaternion must have norm 1 within 1e-4
    -> give the scalar part first, as q0
earth.two_frames: orbit and attitudes are in two different inertial frames
    -> transform them to one frame
digitalglobe.numbered: the records of a list must be numbered 1, 2, 3, ...; this one should be {expected}
    -> use the original file
digitalglobe.count: the list has {n} records {name}
    -> the file is truncated or damaged: use the original file
digitalglobe.distortion: the rigorous model of a camera with optical distortion is not read
    -> use the RPC of the file: <model> rpc
digitalglobe.arrays: an image of level 1B has one detector array
    -> use the RPC of the file: <model> rpc
lattice.count: the lattice has {n} {what}
    -> the file is truncated or damaged: use the original file
earth.seconds: times must be seconds since 0 h UTC of the day of the image
    -> subtract the day
frame.camera: this value of the camera is not possible
    -> give {expected}
metashape.sensors: the file must have one sensor with an adjusted calibration
    -> export the cameras of one sensor
metashape.kind: only the calibration of a frame camera is read
    -> give type = "frame"
metashape.size: width and height must be whole numbers from 1 to 1000000
metashape.params: the names of the calibration values are unknown or occur twice
    -> give some of f cx cy b1 b2 k1 k2 k3 k4 p1 p2
frame.unknown: the camera has no unknown of this name, or the prior sigma is not above zero
rpc.unknown_order: unknown order of coefficients
rpc.unknown_format: this is not an RPC file that can be read
rpc.target_name: unknown output format
rpc.compensation_kind: unknown compensation
rfm.denominators: unknown kind of denominators
rfm.selector: unknown selection of coefficients
    -> choose one of {known}
frame.nothing_unknown: the camera has no unknown, so its image cannot be adjusted
    -> name some unknowns with their prior sigmas; small prior sigmas hold the camera almost fixed
frame.shared: images that share this unknown ({id!r}) have different prior sigmas or start values
    -> give all of them the same prior sigma and the same start value
frame.shared_not: images share unknowns ({id}), which is not possible here
    -> leave the shared id out, or give each image separate unknowns
frame.no_direction: the distortion of the camera cannot be inverted at this pixel
    -> check k1, k2, k3, p1, p2: the polynomial folds inside the image
frame.local: the image is in a local coordinate system, which has no heights above the ellipsoid
    -> intersect the point from two images, or give the camera in Earth-fixed coordinates
bal.unreadable: the bundle file cannot be read
    -> give a text file, plain or compressed by gzip or bzip2
bal.header: a bundle file begins with three counts: cameras, points, observations
    -> check that this is a file of Bundle Adjustment in the Large
bal.count: the counts of the first line require {expected} numbers in total
    -> the file is truncated or damaged: copy it again
bal.number: this is not a finite number
    -> the file is damaged: copy it again
bal.index: there is no camera or point of this number
    -> cameras and points are counted from 0; here the last number is {last}
bal.focal: the focal length is not above zero
    -> the file is damaged, or has another camera model
frame.angles: a frame image has either the angles of its camera or a rotation matrix
    -> give either omega_phi_kappa_deg or rotation
sensor.toml: a sensor description or frame image must state its kind
    -> give kind = {known}
navigation.image: the project has no image with this id
    -> use the image ids of the project
navigation.twice: the image has two navigation records
    -> keep one record per image
navigation.sigma: the standard deviation is not above zero
    -> give metres or degrees, as the column says
navigation.kind: only frame images in Earth-fixed coordinates can have navigation observations
    -> leave the image out of the navigation table
frame.mixed: images in a local coordinate system and Earth-fixed ones cannot be in one block
    -> transform them to one system
rpc.shape: the array must have the shape {shape}
    -> give 5 offsets, 5 scales and 4 x 20 coefficients
rpc.not_finite: a value is not finite
rpc.coefficient_count: 20 coefficients are needed, {count} are given
    -> use the original file
rpc.zero_scale: the scale is zero
    -> use the original file; a scale is half the range of its coordinate
rpc.denominator_constant: the constant of a denominator must be 1
    -> divide all 40 coefficients of this coordinate by it
rpc.pole: the denominator is not positive everywhere inside the image: the model fails near there
    -> fit it again with fewer or regularised coefficients; in Python RpcSensor(model, poles=True) accepts it
rpc.outside: the point is outside the validity range of the model
    -> valid: longitude {lon}, latitude {lat}, height {height} m; {check},
       or add <extrapolate>
rpc.no_direct: the file contains no coefficients from image to ground
    -> use locate(), which inverts the projection by iteration
rpc.no_ground: the pixel has no ground point at this height
    -> the model is valid for heights of {height} m (ellipsoidal)
rpc.compensation: the compensation needs {count} finite numbers
    -> give pixels: shift, drift with the line, drift with the sample, each for line and sample
rpc.list_count: a list of RPC must contain 90 numbers
    -> give 5 offsets, 5 scales (line, sample, latitude, longitude, height) and 4 x 20 coefficients
rpc.missing: {field} is missing
    -> use the complete RPC file of the product
rpc.doubled: {field} is given twice
    -> remove the wrong one
rpc.not_a_number: this is not a plain finite number
    -> write it as 123.456 or 1.23e-4, with a decimal point
rpc.syntax: the line cannot be understood
    -> write {expected}
rpc.order: the coefficients are in the order {found}, not {asked}
    -> if the file is right, give <order> {found}, or read_rpc(path, order='{found}')
rpc.origin: a plain list of numbers does not state the coordinates of the first pixel
    -> give <first_pixel> 0, or 1 for Pléiades; in Python read_rpc(path, first_pixel=0)
rpc.no_tags: the image contains no RPC
    -> give the RPC file of the image
rpc.no_rasterio: RPC in images need rasterio
    -> install the extra: pip install 'fg-orient[geo]'
rpc.unreadable: the file cannot be read
    -> give a readable file
rpc.tags_target: RPC tags can only be written into an existing GeoTIFF
    -> give the image itself, or a name that ends with _RPC.TXT, .RPB or .XML
rpc.sidecar: there is an RPC file next to the image, and GDAL would read it instead of the tags
    -> move this file away, or write the RPC to a file instead of the tags
rpc.heights: this is not a range of heights
    -> give the lower height and then the higher height, m above the ellipsoid
rpc.no_overlap: the two models have no common part of the image
    -> lines and samples of the checked model are {mine}; compare models of the same image
rpc.few_control: too few control points for this compensation
    -> the compensation needs {least}; measure more points, or choose a simpler compensation
rpc.control_spread: the control points do not determine this compensation
    -> the points lie on one line of the image: measure points beside this line, or choose a simpler compensation
rpc.solver_form: a solver can be chosen for the linear form only
    -> add <equations> linear
rpc.unscaled: coefficients without normalisation cannot be written, because the formats need offset and scale
    -> leave out <out> or <no_normalise>
rpc.no_heights: a fit to a sensor needs heights
    -> give <heights> LOW HIGH, m above the ellipsoid
rpc.foreign_option: {option} does not apply to {source}
    -> leave it out
rpc.target: the end of the name does not identify the output format
    -> end the name with _RPC.TXT, .RPB, .XML or .TIF
rpc.image_size: the image does not have the {lines} x {samples} pixels of the RPC
    -> give the image to which the RPC belongs
handover.program: unknown program
    -> give one of: {known}
handover.no_target: a result folder needs the program or the format for which its RPC are written
    -> give <for> gdal, qgis, otb, asp, cars or s2p, or <to> and a format
handover.no_rpc: no image of the result has an RPC
    -> fit one: fg-orient rpc fit METADATA <result> RESULT <heights> LOW HIGH
handover.no_image: there is no RPC image with this id
    -> give one of: {known}
handover.image_words: this does not state to which image the raster belongs
    -> write ID=FILE
handover.needs_image: the format {format} is a raster, so it needs the image
    -> give the image by <image>
handover.names: two images would get files of the same name
    -> give rasters of different names
handover.rigorous (warning): the image has a rigorous model and no RPC, so nothing is written for this image
    -> fit one: fg-orient rpc fit METADATA <result> RESULT <heights> LOW HIGH
handover.adjust (note): use this file with the vendor's RPC, as bundle_adjust_prefix of ASP; the largest difference is
    {most_px:.2g} px. In the file name, adjust is the prefix and the image name follows
handover.no_translation (warning): no .adjust file is written: the compensation is not a translation of the camera. The
    nearest translation differs by up to {most_px:.2g} px, the limit is {limit:g}
    -> use the RPB, which contains the compensation
rpc.pole_inside (doubt): a denominator is not positive everywhere inside the image: {where}
rpc.near_zero_inside (doubt): a denominator comes near zero inside the image: {least:.3g}
rpc.near_zero (doubt): a denominator comes near zero: {least:.3g}
rpc.pixels_without_ground (doubt): {n} of {pixels} pixels have no ground point at their height
rpc.directions_disagree (doubt): the file's models to the ground and to the image differ by up to {largest_px:.1f} px
rpc.round_trip (doubt): the written file, read again, differs from the model by up to {largest_px:.2g} px
    -> do not use this file; choose another format
rpc.points_outside (doubt): {n} point(s) lie outside the validity range: {points:5}
rpc.extrapolated (warning): the {coordinate} is extrapolated: {used:.2f} of the model's range is used
rpc.heights_beyond (warning): the heights are outside the validity range {low:g} .. {high:g} m
rpc.too_many_left_out (doubt): {n} control points were left out and more are suspicious: too many for gross errors
    -> take another compensation, or check coordinates, heights and order of the file
rpc.no_fit (doubt): the points do not fit the model: sigma0 = {sigma0:.2f}, the upper end of its 99.9 % interval is
    {limit:.2f}; the residuals are {rms_px:.1f} px (RMS)
    -> check that the RPC belongs to this image, and check the pixel origin and the height system
rpc.sigma0 (doubt): sigma0 = {sigma0:.3f} lies above {limit:.3f}, the upper end of its 99.9 % interval: the residuals
    are {rms_px:.2f} px (RMS), the sigmas in the file {sigma_px:.2f} px
    -> correct the sigmas, take a compensation with more terms, or correct wrong points
rpc.sigma0_assumed (warning): sigma0 = {sigma0:.3f} px lies above {limit:.3f}, the upper end of its 99.9 % interval for
    the assumed sigmas of 1 px
    -> give the sigmas in the columns sigma_line_px and sigma_sample_px, so that this is tested
rpc.beyond_prior (doubt): the points change this term by {value_px:+.1f} px, {size:.1f} times the standard deviation of
    such a change; the prior standard deviation is {sigma:.3g} px ({source})
    -> check that lines and samples count from the first pixel of the whole image, not of a part of it, and that the
       RPC belongs to this image
rpc.check_far (doubt): {n} of {of} check point(s) contradict the compensation: {points:10}; the residual of {worst} is
    {line_px:+.1f} px in line, {sample_px:+.1f} px in sample, {size:.1f} standard deviations; the limit is {limit:.1f}
    -> check the coordinates and pixels of these points and of the control points
rpc.against (doubt): this model and {other} differ by up to {largest_px:.2f} px, at {where}; the limit is {limit:g} px
    + ; RMS {rms_px[0]:.2f} px in line, {rms_px[1]:.2f} px in sample
    + ; the difference is nearly constant, {constant_px[0]:+.2f} px in line, {constant_px[1]:+.2f} px in sample: another
      pixel origin, or a bias that only one of the two contains
    -> check that both belong to the same image, and the pixel origin (<first_pixel>)
rpc.gross_error (warning): point {point}: gross error of about {line_px:+.2f} px in line, {sample_px:+.2f} px in
    sample; F = {statistic:.1f}, limit {limit:.1f}
rpc.no_redundancy (warning): there is no redundancy: standard deviations are null and gross errors cannot be found
rpc.heights_system (warning): misclosures change with the height by {line:+.1f} (line), {sample:+.1f} (sample) px per
    1000 m: check the height system, and check that the RPC belongs to this image
rpc.check_points (warning): these check points do not fit: {points:40}
rpc.sign_change (doubt): a denominator changes its sign among the points (least {least:.3g}): the model fails near
    there
rpc.near_zero_among (doubt): a denominator comes near zero among the points: {least:.3g}
rpc.linear_m0 (doubt): m0 of the linear form, {linear_px:.2f} px, is not the accuracy of the image: {true_px:.2f} px
rpc.not_validated (doubt): there are too few points for cross-validation: the accuracy between the points is unknown
rpc.folds_failed (doubt): {failed} of {folds} parts of the cross-validation have no solution
rpc.overfitted (doubt): the RMS is {left_out_px[0]:.2f}, {left_out_px[1]:.2f} px (line, sample) at points left out, but
    {fit_px[0]:.2f}, {fit_px[1]:.2f} px in the fit: the points do not determine so many coefficients
rpc.of_solver (warning): {note}
rfm.points: control points need finite lines and samples (n,) and ground coordinates (n, 3)
    -> give one row per point; ground: longitude, latitude (degrees), height (m)
rfm.flat: all points have the same value of this coordinate, so the coordinate cannot be normalised and its
    coefficients cannot be estimated
    -> measure points that differ in this coordinate, or choose a lower degree without it
rfm.degree: the degree of a rational function model is 1, 2 or 3
    -> give one of them
rfm.kept: the kept coefficients must be ascending indices of the unknowns
    -> see RfmForm.names
rfm.penalty: the penalty must be beyond_affine or identity
    -> give one of the two
rfm.few_points: too few control points for {unknowns} coefficients
    -> at least {least} are needed; choose a lower degree, common denominators, or a penalty (kappa > 0)
rfm.pole: a denominator vanishes or changes its sign at the control points or between them: the model has a pole there
    -> choose a lower degree, fewer coefficients or a penalty: <degree>, <select>, <kappa>
rfm.no_end: the iteration does not converge
    -> choose a lower degree, fewer coefficients or a penalty (kappa > 0)
rfm.folds: the number of folds must lie between 2 and the number of points
    -> there are {points} points
rfm.grid: the virtual grid needs at least {least} values per axis
    -> choose more lines, samples or layers
rfm.heights: the lowest height must be below the highest
    -> give the lowest first, then the highest, in m above the ellipsoid
rfm.data: the file must contain rows of id, line, sample, latitude, longitude (degrees), height (m)
    -> give the file of control points of the SPOT-6 scene, or its folder
""")
