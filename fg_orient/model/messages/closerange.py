"""Messages about close range: DLT, resection, intersection, orientation, surfaces."""

from __future__ import annotations

from typing import Final

from fg_orient.model.messages.entry import words

WORDS: Final = words("""
closerange.points: points must be finite numbers, {width} per row
    -> check the values
closerange.range: the number is too large to be a coordinate
    -> give at most {limit:g} in size; check for a wrong digit or another unit
closerange.sigma_range: this value is too small or too large for a standard deviation
    -> give {least:g} to {limit:g}, in the unit of the points
closerange.sigma: standard deviations must be finite numbers above 0
    -> give them in the unit of the points
closerange.relative: a standard deviation in metres or radians cannot be used together with {points} without standard
    deviations, whose weights are only relative
    -> give <sigma>, or columns of standard deviations in {points}
closerange.needs_sigma: this needs standard deviations of the image points, and {points} has none
    -> give <sigma>, or columns of standard deviations in {points}
closerange.not_converged: the adjustment does not converge: {reason}
    -> search for gross errors in the points, and check their distribution
closerange.other_reading: y of the image coordinates has the other direction, or x and y are exchanged: then the
    points fit {times:.0f} times better (median)
    + ; photos {photos:5}
    -> check y_axis in the photo file, and the columns x and y of the image points
closerange.exchanged_point: x and y look exchanged in the image points of {points:5}
    -> exchange these two values
closerange.surface: these parameters do not define a surface
    -> give finite numbers {shape}, semi-axes above 0
closerange.kind: this is not possible with this kind of surface
closerange.method: unknown method
closerange.prior: the observed parameter is unknown, or its value or sigma is not possible (lengths are above 0); the
    algebraic method and quadrics do not accept observed parameters
closerange.member: the constraint names a point or photo that is not measured or does not exist
closerange.parameter: this is not the name of a camera parameter or of a set of camera parameters
    -> choose one of {known}
closerange.axis: unknown axis of revolution
    -> choose one of x, y, z, free
closerange.few: too few points
    -> give {least} or more
closerange.undetermined: these points do not determine all unknowns: {names} ({direction}); a standard deviation
    exceeds {limit:g} times the standard deviation of a point
    -> measure points elsewhere (other levels of the surface, other depths), or observe a parameter; give the sigma of
       the points if it is not given yet
closerange.unverified: it could not be verified that the points determine {name}: no fit with a far value of {name}
    converges
    -> measure points elsewhere (other levels of the surface), observe {name}, or give the sigma of the points
closerange.camera: this value of the camera is not possible
closerange.constraint: this constraint is not possible
closerange.bundle: this part of the bundle is not possible
    -> give {expected}
closerange.fold: the distortion of the camera cannot be inverted here
    -> check k1, k2, k3, p1, p2: the polynomial folds inside the image
closerange.distortion: this distortion of a DLT is unknown, or the direct solution cannot estimate it
    -> choose one of {known}, with the iterative solution
closerange.plane: the control points do not determine a DLT: they lie in a plane or close to a plane
    -> add points in front of the plane and behind it, or use resect, which needs a known camera
closerange.critical: the control points do not determine a DLT, although they do not lie in a plane. Either points and
    camera are close to another critical configuration (a twisted cubic; a plane and a line through the camera), or the
    camera is far away
    -> add points at other places and depths, or use resect, which needs a known camera
closerange.flat: within the noise of the image the control points lie in a plane (RMS distance from the plane
    {height}), and the photo of a plane does not determine the camera
    -> add points in front of the plane and behind it, give <sigma> if you know it, or use resect, which needs a known
       camera
closerange.parallel_noise: the projection is parallel within the noise of the image, so the distance of the camera is
    not determined
    -> add points at other depths, or use resect, which needs a known camera
closerange.parallel: the projection is parallel or degenerate: it has no projection centre
    -> check the control points
closerange.behind: the solution puts a point behind the camera
    -> search for gross errors and exchanged points
closerange.no_start: no position of the camera fits any three of the points
    -> check focal length, y_axis and the numbers of the points
closerange.pose: the points do not determine the orientation of the photo (on a line, or on a cylinder through the
    camera)
    -> measure points elsewhere
closerange.one_ray: the point is seen in one photo only
    -> measure it in a second one, or leave it out
closerange.no_ray: the point is seen in no photo
    -> measure it in two photos, or leave it out
closerange.datum: nothing ties these photos to the coordinate system
    -> give three control points or more that do not lie on a line, or observed projection centres; a distance fixes
       the scale; <datum> inner adjusts a free network
closerange.unobservable: the observations do not determine this
    -> leave one of these unknowns out, observe it, or measure points at other depths
closerange.parallel_rays: the rays to the point are close to parallel: its distance is not determined
    -> measure it in a photo from another place
closerange.parallax: the parallax is not above 0
    -> check that left and right are not exchanged
closerange.no_pair: no orientation of the pair has all points in front of both cameras
    -> look for mixed-up points, and check focal lengths and y_axis
closerange.no_base: the photos were taken from one place, within noise: a rotation alone fits all points
    -> take the second photo from elsewhere; photos of one place give no points in space
closerange.pair: the points do not determine the relative orientation (too close together, or on a plane through the
    base)
    -> measure points that fill the common part of both photos, at several depths
closerange.line: the points lie on a line or at one place, so they do not determine the rotation about this line
    -> add points beside the line
closerange.no_camera: the photo has no camera
    -> give focal, principal and y_axis of the photo
closerange.not_oriented: the photo is not oriented
    -> give rotation, centre_m and focal, or matrix and origin_m: closerange dlt and resect write them
closerange.no_photo: the file has no photo of this name
    -> photos in the file: {known}
closerange.two_photos: a relative orientation needs exactly two photos
    -> give a table with the image points of two photos
closerange.equal_sigmas: a relative orientation needs equal standard deviations of all image coordinates
    -> leave the columns out and give <sigma>
closerange.station_twice: the photo has two rows of stations
    -> keep one row per photo
closerange.no_model: the format contains no cameras and poses
    -> choose photomodeler, or a format of a bundle program in docs/formats
closerange.control_mixed: this control point has no standard deviation, but others have one
    -> give standard deviations for all control points or for none
closerange.not_in_project: the project has none of the control points
    -> points in the project: {known}, ...
closerange.control_left_out (note): {n} control point(s) that the project does not have are left out: {names}
closerange.direction: the distortion of this camera converts ideal to measured coordinates; close range needs the
    distortion from measured to ideal coordinates
    -> use the camera without distortion and determine k1 to p2: <shared> k1,k2,p1,p2
closerange.check_and_control: a point cannot be both check point and control point
    -> remove the point from <control> or from <check>
closerange.no_layers: close-range results have no true values and no geographic coordinates
    -> leave the option out; points.csv contains the coordinates
closerange.printed_sigma: a published standard deviation must be a number above 0
    -> correct it, or leave the cell empty
closerange.printed_digits: the number of significant digits must be a whole number from 1 to {limit}
    -> correct it, or leave the cell empty
closerange.printed_twice: {first} has this name already
    -> keep one row per value
closerange.printed_name: the result has no values of these names; {hint}
    -> use the names of the result: m0, camera all c, photo NAME X0, point ID x_m, camera all k1/k2 (correlation)
closerange.dependent: this hard constraint follows from the others, or contradicts them
    -> leave it out, or give it a sigma
closerange.saddle: this hard constraint is not met, and no small change of the start values brings it nearer (for
    example parallel lines that start at right angles)
    -> check for a wrong member, or start with points closer to the constraint
closerange.contradiction: these hard constraints contradict each other: {names}
    -> check for a wrong value or member; give the constraints sigmas, or leave one out
closerange.merged: these hard constraints can be met together only if the points {points} are at one place: {names}
    -> check for a point that is not on a figure; give the constraints sigmas, or leave one out
closerange.no_place: the point is seen in one photo only and has no coordinates
    -> measure it in a second photo, give its coordinates, or leave it out
closerange.prior_text: this is not an observed parameter
    -> write it as name=value:sigma, for instance b=0.845:0.001
closerange.no_redundancy (warning): there is no redundancy, so there are no standard deviations
closerange.m0_large (doubt): m0 = {size:.3f} lies above {limit:.3f}, the upper end of its 99.9 % interval: the
    observations do not fit the model within their standard deviations. These are too small, or the model lacks
    something, or there are gross errors
    + , or y of the image coordinates points the other way ({axis})
closerange.m0_small (warning): m0 = {size:.3f} lies below {limit:.3f}, the lower end of its 99.9 % interval: the given
    standard deviations are too large, and the result looks less accurate than it is
closerange.large_residual (doubt): {what} is {size:.1f} times {over}: a gross error is suspected
    + ; {more} more residual(s) are too large, perhaps because of this error
    -> check the measurement and the coordinates of this point
closerange.little_redundancy (warning): with redundancy 1, m0 and the standard deviations are ten times too small in 8
    of 100 cases. In one of 15 cases, points that are flat within the noise are not detected
    -> give <sigma>
closerange.nearly_parallel (warning): the projection is {sigmas:.2g} sigmas from a parallel one: standard deviations of
    the centre and of the principal distances are too small; they are correct only above {honest:.3g} sigmas
closerange.second_pose (warning): a second pose fits nearly as well, centre at {centre_m[0]:.4g}, {centre_m[1]:.4g},
    {centre_m[2]:.4g} m. Its weighted sum of squares is {ratio:.3g} times as large; an F test at 5 % distinguishes the
    poses only above {limit:.3g}
    -> add control points off the plane
closerange.second_orientation (warning): a second orientation fits nearly as well, base along {base[0]:.4g},
    {base[1]:.4g}, {base[2]:.4g}. Its weighted sum of squares is {ratio:.3g} times as large; a test at 5 %
    distinguishes the orientations only above {limit:.3g}
    -> add points, some of them off the plane
closerange.unseen_control (warning): these control points are not measured in any photo: {names:40}
closerange.unseen_check (warning): these check points are not measured in any photo: {names:40}
closerange.unseen_station (warning): these stations belong to photos without image points: {names:40}
closerange.no_photo_file (warning): photos.toml is not written, because it cannot contain {parameters:40}
""")
