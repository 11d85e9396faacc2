"""Messages about close range: DLT, resection, intersection, orientation, surfaces."""

from __future__ import annotations

from typing import Final

from fg_orient.model.messages.entry import words

WORDS: Final = words("""
closerange.points: points are finite numbers, {width} a row
    -> check the values
closerange.range: the number is too large to be a coordinate
    -> give at most {limit:g} in size; look for a wrong digit or another unit
closerange.sigma_range: no standard deviation has this size
    -> give {least:g} to {limit:g}, in the unit of the points
closerange.sigma: standard deviations are finite numbers above 0
    -> give them in the unit of the points
closerange.relative: a standard deviation in metres or radians means nothing beside points of {points} that have
    none: their weights are only relative
    -> give <sigma>, or columns of standard deviations in {points}
closerange.needs_sigma: this needs standard deviations of the image points, and {points} has none
    -> give <sigma>, or columns of standard deviations in {points}
closerange.not_converged: the adjustment does not converge: {reason}
    -> look for gross errors in the points, and at their distribution
closerange.surface: these parameters make no surface
    -> give finite numbers {shape}, semi-axes above 0
closerange.kind: not possible with this kind of surface
closerange.method: no such method
closerange.prior: no such observed parameter, or a value or sigma that is not possible (lengths are above 0); the
    algebraic method and quadrics take none
closerange.member: the constraint names a point or photo that is not measured, or not there
closerange.parameter: this is no name of a camera parameter, nor of a set of them
    -> choose one of {known}
closerange.axis: no such axis of revolution
    -> choose one of x, y, z, free
closerange.few: too few points
    -> give {least} or more
closerange.undetermined: not determined by these points: {names} ({direction}); a standard deviation exceeds
    {limit:g} times that of a point
    -> measure points elsewhere (other levels of the surface, other depths), or observe a parameter; give the sigma
       of the points if it is known
closerange.unverified: whether the points determine {name} could not be verified: no fit with it held far away
    converges
    -> measure points elsewhere (other levels of the surface), observe {name}, or give the sigma of the points
closerange.camera: this value of the camera is not possible
closerange.constraint: this constraint is not possible
closerange.bundle: this part of the bundle is not possible
    -> give {expected}
closerange.fold: the distortion of the camera cannot be inverted here
    -> check k1, k2, k3, p1, p2: the polynomial folds inside the image
closerange.distortion: no such distortion of a DLT, or one that the direct solution does not have
    -> choose one of {known}; they need the iteration
closerange.plane: the control points do not determine a DLT: they lie in a plane, or close to it
    -> add points in front of it and behind, or use resect, which needs a known camera
closerange.critical: the control points do not determine a DLT, though they lie in no plane: with the camera they
    are near another critical configuration (a twisted cubic; a plane and a line through the camera), or it is far
    away
    -> add points elsewhere, in front and behind, or use resect, which needs a known camera
closerange.flat: the control points are flat within the noise of the image: heights of {height} rms above a plane,
    whose photo alone leaves the camera open
    -> add points in front of it and behind, state <sigma> if it is known, or use resect, which needs a known camera
closerange.parallel_noise: the projection is parallel within the noise of the image, which leaves the distance of
    the camera open
    -> add points in front and behind, or use resect, which needs a known camera
closerange.parallel: the projection is parallel or degenerate: it has no projection centre
    -> check the control points
closerange.behind: the solution puts a point behind the camera
    -> look for gross errors and mixed-up points
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
closerange.parallel_rays: the rays to the point are close to parallel: its distance is open
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
closerange.line: the points lie on a line or at one place, and do not determine the rotation about it
    -> add points off the line
closerange.no_camera: the photo has no camera
    -> give its focal, principal and y_axis
closerange.not_oriented: the photo is not oriented
    -> give rotation, centre_m and focal, or matrix and origin_m: closerange dlt and resect write them
closerange.no_photo: the file has no such photo
    -> photos in it: {known}
closerange.two_photos: a relative orientation needs exactly two photos
    -> give a table with the image points of two photos
closerange.equal_sigmas: a relative orientation needs equal standard deviations of all image coordinates
    -> leave the columns out and give <sigma>
closerange.station_twice: the photo has two stations
    -> give each photo one row
closerange.no_model: the format holds no cameras and poses
    -> choose photomodeler, or a format of docs/formats that bundle programs have
closerange.control_mixed: the point is exact, and others have standard deviations
    -> give all control points standard deviations, or none
closerange.not_in_project: the project has none of the control points
    -> points in it: {known}, ...
closerange.control_left_out (note): {n} control point(s) that the project does not have are left out: {names}
closerange.direction: the distortion of this camera leads from ideal to measured coordinates, that of close range
    the other way
    -> take the camera without distortion and determine k1 to p2: <shared> k1,k2,p1,p2
closerange.check_and_control: a point cannot judge the result and take part in it
    -> leave it out of <control>, or of <check>
closerange.no_layers: results of close range have no truth and no geographic coordinates
    -> leave the option out; points.csv holds the coordinates
closerange.printed_sigma: a published standard deviation is a number above 0
    -> correct it, or leave the cell empty
closerange.printed_digits: the number of significant digits is a whole number from 1 to {limit}
    -> correct it, or leave the cell empty
closerange.printed_twice: {first} has this name
    -> give each value one row
closerange.printed_name: the result has no values of these names; {hint}
    -> use the names of the result: m0, camera all c, photo NAME X0, point ID x_m, camera all k1/k2 (correlation)
closerange.dependent: this hard constraint follows from the others, or contradicts them
    -> leave it out, or give it a sigma
closerange.saddle: this hard constraint is not met, and no small change of the start brings it nearer (as lines at
    right angles that shall be parallel)
    -> look for a wrong member, or begin with points nearer to the constraint
closerange.contradiction: these hard constraints cannot hold together: {names}
    -> look for a wrong value or member; give them sigmas, or leave one out
closerange.merged: these hard constraints hold together only with the points {points} at one place: {names}
    -> look for a point that is not on a figure; give the constraints sigmas, or leave one out
closerange.no_place: the point is seen in one photo only and has no coordinates
    -> measure it in a second photo, give its coordinates, or leave it out
closerange.prior_text: not an observed parameter
    -> write it as name=value:sigma, for instance b=0.845:0.001
closerange.no_redundancy (warning): there is no redundancy, so there are no standard deviations
closerange.little_redundancy (warning): redundancy 1: m0, and standard deviations with it, are ten times too small
    in 8 of 100 sets, and 1 of 15 sets that are flat within the noise passes
    -> give <sigma>
closerange.nearly_parallel (warning): the projection is {sigmas:.2g} sigmas from a parallel one: standard deviations
    of the centre and of the principal distances are too small (honest from {honest:.3g} on)
closerange.second_pose (warning): a second pose fits nearly as well, centre at {centre_m[0]:.4g}, {centre_m[1]:.4g},
    {centre_m[2]:.4g} m: weighted squares {ratio:.3g} times as large, an F test at 5 % tells poses apart from
    {limit:.3g} on
    -> add control points off the plane
closerange.second_orientation (warning): a second orientation fits nearly as well, base along {base[0]:.4g},
    {base[1]:.4g}, {base[2]:.4g}: weighted squares {ratio:.3g} times as large, a test at 5 % distinguishes orientations
    from {limit:.3g} on
    -> add points, some of them off the plane
closerange.unseen_control (warning): control points measured in no photo: {names:40}
closerange.unseen_check (warning): check points measured in no photo: {names:40}
closerange.unseen_station (warning): stations of photos without image points: {names:40}
closerange.no_photo_file (warning): photos.toml is not written: it cannot hold {parameters:40}
""")
