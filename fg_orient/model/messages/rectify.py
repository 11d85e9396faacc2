"""Messages about rectification: transformations between image and map, map accuracy, areas."""

from __future__ import annotations

from typing import Final

from fg_orient.model.messages.entry import words

WORDS: Final = words("""
rectify.points: points need finite source coordinates (n, 2) or (n, 3), target coordinates (n, 2) and sigmas (n, 2)
    above 0
    -> give one row per point, ids as many as rows
rectify.model: no such transformation
rectify.standard: no such accuracy standard
    -> choose one of {known}
rectify.degree: the degree of a polynomial is 1 to {most}, and no other transformation has one
    -> give <degree> to a polynomial, or leave it out
rectify.direction: no such direction
    -> choose one of image-to-map, map-to-image
rectify.few_points: {points} control points give {equations} equations for {unknowns} unknowns: no redundancy, so no
    m0
    -> at least {least} points are needed; take a transformation with fewer unknowns
rectify.collinear: the control points lie on a straight line (or at one place) and do not determine the
    transformation
rectify.narrow: within their noise the control points lie on a straight line: along {direction} they spread over
    only {times:.1f} times their noise
    -> measure points off this line
rectify.degenerate: the control points do not determine {model}: they lie {figure}
    -> measure points elsewhere, or take a transformation with fewer unknowns
rectify.pole: a denominator vanishes or changes its sign among the control points
    -> look for gross errors in the points, or take another transformation
rectify.not_converged: the adjustment does not converge: {reason}
    -> look for gross errors in the points
rectify.heights: this transformation needs heights: it relates ground coordinates with heights to the image
    -> add a column height_m, or take a plane transformation
rectify.no_crs: longitude and latitude need a map projection to be fitted in, and none is given
ortho.no_crs: no coordinate system of the map is known
    -> add <crs> with a projected coordinate system, for instance EPSG:32636
rectify.crs_not_projected: this coordinate system is not a map projection in metres
    -> give the code of a projected one, for instance EPSG:32636
rectify.sigmas: sigmas of the side that is given, not of the side whose residuals are adjusted
    -> with {direction} give {columns}, or turn the direction
rectify.role: no such role of a point
    -> give control (takes part) or check (compared only)
rectify.id_twice: the point occurs twice
    -> give each point one row
rectify.no_check_points: a design study compares at independent points, and the table has no check points
    -> give some points the role check
rectify.counts: no such number of control points
    -> give whole numbers from 1 to {most}, for instance 5,10,20
rectify.prune: the target is not reached with the points that the transformation needs: {reached:.4g} with {points}
    points
    -> raise the target, or take another transformation
rectify.positive: this must be a finite number above 0
    -> give it in {unit}
rectify.numbers: finite numbers are needed, at least one, and as many of each kind
    -> look for missing values, nan and lists of unequal length
rectify.sigma_absurd: the sigma is too small: coordinates of this size are stored to {least:.1g}, and the largest
    sigma, {largest:.1g}, may be {span:.0e} times the smallest at most
    -> give sigmas of the size of the coordinates' errors, or none
rectify.differences: differences must be finite numbers (n, 2)
    -> give one row per tested point: measured minus true, east and north
rectify.outline: an outline needs three or more vertices (n, 2), finite, not on one line
    -> check the vertices
rectify.projection: PROJ has no such projection
    -> write it as PROJ does: +proj=tmerc +lon_0=27 ...
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
rectify.ellipsoid: PROJ has no such ellipsoid
    -> give PROJ's name, for instance WGS84, intl, clrk66
ortho.no_rasterio: rasters need rasterio
    -> install the extra: pip install 'fg-orient[geo]'
ortho.image: the image cannot be read
    -> give a raster that GDAL reads
ortho.kind: values of this type cannot be resampled
    -> give an image of real numbers, whole or not
ortho.size: the image does not have the {lines} x {samples} pixels of its metadata
    -> give image and metadata that belong together, the whole image
ortho.other_crs: the transformation was fitted in {fitted}
    -> leave out <crs>, or fit in this system
ortho.over_input: the map would replace a file that it is made of
    -> give another <out>
ortho.foreign: this file is not a raster, so <overwrite> may not replace it
    -> give another <out>, or move it
ortho.points_and_result: a transformation by points takes no orientation of an image
    -> give only one of {option} and the transformation
ortho.no_heights: rectification through this model needs heights
    -> give <dem> or <height>
ortho.grid: no such map raster: sides {value} at a resolution of {resolution:g}, at most {most} pixels each
    -> check <bounds> (left bottom right top) and <resolution>, both in units of the map
ortho.no_overlap: {what} and the image have no ground in common
    -> check that both show the same region, and the coordinate system
ortho.outline: the model finds no place on the map for this pixel, so the extent of the image is unknown
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
rectify.gross_error (warning): {kind} {point}: gross error of about {error[0]:+.2f}, {error[1]:+.2f} {unit}; F =
    {statistic:.1f}, limit {limit:.1f}
rectify.rmse_after_pruning (warning): points were left out until the RMSE was small enough. The RMSE therefore does
    not measure the accuracy
rectify.no_check (warning): no check points: residuals of control points are smaller than errors elsewhere
rectify.hardly_checked (warning): hardly checked by the others (redundancy below {limit}): {points:40}
rectify.little_reach (warning): the control points reach little along {direction}: the scale there is known
    {ratio:.0f} times worse than along them, to {percent:.2g} %
rectify.hardly_determined (warning): the points hardly determine the transformation: condition {condition:.2g},
    usual is {typical:g}: they lie near {what} of its form
rectify.sigma_size (warning): the residuals are {m0:.2g} times as large as the sigmas: sigmas of another unit or size?
rectify.sigma_span (warning): one sigma is {span:.1g} times another: points with large ones carry negligible weight
rectify.far_from_zone (warning): {n} control point(s) lie far outside the area of {crs} ({west:g} to {east:g}
    degrees east, {south:g} to {north:g} north), such as {point} ({where}): another zone, or swapped coordinates?
rectify.check_worse (warning): check points are {ratio:.1f} times worse than control points predict: too high a
    degree, or gross errors
""")
