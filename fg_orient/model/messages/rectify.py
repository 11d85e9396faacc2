"""Messages about rectification: transformations between image and map, map accuracy, areas."""

from __future__ import annotations

from typing import Final

from fg_orient.model.messages.entry import words

WORDS: Final = words("""
rectify.points: points need finite source coordinates (n, 2) or (n, 3), target coordinates (n, 2) and sigmas (n, 2)
    above 0
    -> give one row and one id per point
rectify.model: unknown transformation
rectify.standard: unknown accuracy standard
    -> choose one of {known}
rectify.degree: a polynomial has a degree from 1 to {most}, other transformations have no degree
    -> give <degree> with a polynomial only
rectify.direction: unknown direction
    -> choose one of image-to-map, map-to-image
rectify.few_points: {points} control points give {equations} equations for {unknowns} unknowns: there is no redundancy,
    so m0 is not defined
    -> at least {least} points are needed; choose a transformation with fewer unknowns
rectify.collinear: the control points lie on a straight line (or at one place) and do not determine the
    transformation
rectify.narrow: within their noise the control points lie on a straight line: their spread along {direction} is only
    {times:.1f} times their noise
    -> measure points beside this line
rectify.degenerate: the control points do not determine {model}: they lie {figure}
    -> measure points elsewhere, or choose a transformation with fewer unknowns
rectify.pole: a denominator vanishes or changes its sign among the control points
    -> search for gross errors in the points, or choose another transformation
rectify.not_converged: the adjustment does not converge: {reason}
    -> search for gross errors in the points
rectify.heights: this transformation needs heights: it relates ground coordinates with heights to the image
    -> add a column height_m, or choose a plane transformation
rectify.no_crs: a fit to longitude and latitude needs a map projection, and none is given
ortho.no_crs: no coordinate system of the map is known
    -> add <crs> with a projected coordinate system, for instance EPSG:32636
rectify.crs_not_projected: this coordinate system is not a map projection in metres
    -> give the code of a projected one, for instance EPSG:32636
rectify.sigmas: these sigmas belong to the coordinates that are given, not to the coordinates whose residuals are
    minimised
    -> with {direction} give {columns}, or choose the other direction
rectify.role: unknown role
    -> give control (takes part) or check (compared only)
rectify.id_twice: the point occurs twice
    -> keep one row per point
rectify.no_check_points: a design study needs check points, and the table has none
    -> give some points the role check
rectify.counts: this number of control points is not possible
    -> give whole numbers from 1 to {most}, for instance 5,10,20
rectify.prune: the target is not reached with the points that the transformation needs: {reached:.4g} with {points}
    points
    -> raise the target, or choose another transformation
rectify.positive: this must be a finite number above 0
    -> give it in {unit}
rectify.numbers: give lists of the same length with at least one finite number
    -> check for missing values, nan and lists of different length
rectify.sigma_absurd: the sigma is too small: coordinates of this size have a resolution of {least:.1g}, and the largest
    sigma, {largest:.1g}, may be at most {span:.0e} times the smallest sigma
    -> give sigmas of the size of the coordinates' errors, or none
rectify.differences: differences must be finite numbers (n, 2)
    -> give one row per tested point: measured minus true, east and north
rectify.outline: an outline needs at least three finite vertices (n, 2) that do not lie on a line
    -> check the vertices
rectify.projection: this is not a projection of PROJ
    -> write the projection in PROJ's notation: +proj=tmerc +lon_0=27 ...
rectify.projected: plane coordinates are projected already
    -> leave <projection> out, or give lon_deg and lat_deg
rectify.unprojected: pixels are counted in a plane
    -> give <projection> for the coordinates lon_deg and lat_deg
rectify.detector: a detector needs valid grey values that differ
    -> check the number of detectors and the mask
rectify.dark: a dark object needs {least} pixels
    -> take fewer pixels, or a larger image
rectify.outside: this point lies outside the domain of the projection
    -> check longitude and latitude
rectify.saved: this is not a transformation written by rectify fit
    -> give transformation.json of a result folder
rectify.result: this is not a result of rectify fit, or it was altered
    -> give the folder that rectify fit wrote, unchanged
rectify.pruned: the fit left out points until its RMSE was small enough, and it has no check points. The residuals of
    the other control points therefore do not measure the accuracy
    -> give some points the role check, and fit again
rectify.ellipsoid: this is not an ellipsoid of PROJ
    -> give PROJ's name, for instance WGS84, intl, clrk66
ortho.no_rasterio: rasters need rasterio
    -> install the extra: pip install 'fg-orient[geo]'
ortho.image: the image cannot be read
    -> give a raster that GDAL reads
ortho.kind: values of this type cannot be resampled
    -> give an image of integers or real numbers
ortho.size: the image does not have the {lines} x {samples} pixels of its metadata
    -> give image and metadata that belong together, the whole image
ortho.other_crs: the transformation was fitted in {fitted}
    -> leave out <crs>, or fit in this system
ortho.over_input: the map would replace one of its input files
    -> give another <out>
ortho.foreign: this file is not a raster, so <overwrite> may not replace it
    -> give another <out>, or move the file
ortho.points_and_result: a transformation by points does not use the orientation of an image
    -> give only one of {option} and the transformation
ortho.no_heights: rectification through this model needs heights
    -> give <dem> or <height>
ortho.grid: this map raster is not possible: sides {value} at a resolution of {resolution:g}; at most {most} pixels per
    side are allowed
    -> check <bounds> (left bottom right top) and <resolution>, both in units of the map
ortho.no_overlap: {what} and the image do not overlap
    -> check that both show the same region, and the coordinate system
ortho.outline: the model gives no map coordinates for this pixel, so the extent of the image is unknown
    -> give <bounds> and <resolution>, or another transformation
ortho.hole: the DEM has no height inside the image (map pixel row {row}, column {column})
    -> fill the holes of the DEM, or add <allow_holes> to leave them empty
ortho.result: this is not a result folder of adjust with this image
    -> give the folder that adjust wrote; images in it: {known}
ortho.other_image: image {image} of the result was computed from another metadata file ({known})
    -> give the metadata file of that image, or another <image_id>
ortho.which_image: several images of the result have a metadata file of this name and content
    -> give <image_id>: {known}
ortho.other_sensor: the result was computed with another kind of model than this metadata file has
    -> give the metadata file of the project
rectify.gross_error (doubt): {kind} {point}: gross error suspected, of about {error[0]:+.2f}, {error[1]:+.2f} {unit}; F
    = {statistic:.1f}, limit {limit:.1f}
    -> correct or remove the point, the one with the largest F first, and fit again
rectify.suspicious_point (warning): {kind} {point}: perhaps an error of about {error[0]:+.2f}, {error[1]:+.2f} {unit}; F
    = {statistic:.1f}, limit {limit:.1f}
rectify.mirrored (warning): the transformation makes a mirror image: two columns look exchanged, line and sample or
    easting and northing
    -> exchange the two columns; if lines are counted from the bottom of the image, this is no mistake
rectify.relief (warning): the residuals follow the heights of the points, so they show relief: with a term of the height
    m0 is {after:.3g}, without it {before:.3g}
    -> choose <model> affine-3d, or rectify the image by its orientation and a DEM
rectify.rmse_after_pruning (warning): points were left out until the RMSE was small enough. The RMSE therefore does
    not measure the accuracy
rectify.no_check (warning): there are no check points: residuals of control points are smaller than the errors at other
    points
rectify.hardly_checked (warning): the other points hardly check these points (redundancy below {limit}): {points:40}
rectify.little_reach (warning): the control points have a small extent along {direction}: the scale in this direction
    is {ratio:.0f} times less accurate; its standard deviation is {percent:.2g} %
rectify.hardly_determined (warning): the points hardly determine the transformation: condition number {condition:.2g},
    usually {typical:g}. The points are close to {what} of this transformation
rectify.m0_large (doubt): m0 = {size:.3f} lies above {limit:.3f}, the upper end of its 99.9 % interval: the points do
    not fit the transformation within their sigmas. The sigmas are too small or have another unit, or the transformation
    lacks terms, or there are gross errors
rectify.m0_small (warning): m0 = {size:.3g} lies below {limit:.3f}, the lower end of its 99.9 % interval: the sigmas are
    too large, or have another unit
rectify.sigma_span (warning): one sigma is {span:.1g} times another: points with large sigmas have negligible weight
rectify.far_from_zone (warning): {n} control point(s) lie far outside the area of {crs} ({west:g} to {east:g} degrees
    east, {south:g} to {north:g} north), such as {point} ({where}): check the zone and the order of the coordinates
rectify.check_worse (doubt): the errors at check points are {ratio:.1f} times as large as the control points predict:
    the degree is too high, or there are gross errors
""")
