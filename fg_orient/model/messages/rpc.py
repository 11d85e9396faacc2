"""Messages of rational function models (RPC): the model itself and its files."""

from __future__ import annotations

from typing import Final

from fg_orient.model.messages.entry import words

WORDS: Final = words("""
rpc.shape: the array must have the shape {shape}
    -> give 5 offsets, 5 scales and 4 x 20 coefficients
rpc.not_finite: a value is not finite
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
rpc.coefficient_count: needs 20 coefficients, {count} given
    -> use the original file
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
rpc.unknown_order: no such order of coefficients
    -> choose one of {known}
rpc.origin: a plain list of numbers does not say which pixel coordinate the first pixel has
    -> say it: <first_pixel> 0, or 1 for Pléiades; in Python read_rpc(path, first_pixel=0)
rpc.unknown_format: this is no RPC file that can be read
    -> choose one of {known}
rpc.no_tags: the image holds no RPC
    -> give the RPC file that lies beside it
rpc.no_rasterio: RPC in images need rasterio
    -> install the extra: pip install 'fg-orient[geo]'
rpc.unreadable: the file cannot be read
    -> give a readable file
rpc.tags_target: RPC tags are written into an existing GeoTIFF
    -> give the image itself, or a name that ends with _RPC.TXT, .RPB or .XML
rpc.target_name: no such format to write
    -> choose one of {known}
rpc.sidecar: an RPC file beside the image would hide its tags: GDAL prefers the file
    -> move it away, or write it instead of the tags
rpc.role: unknown role
    -> write control or check
rpc.sigma: a sigma must be positive
    -> give the standard deviation of the measurement, pixels
rpc.heights: this is no range of heights
    -> give the lower and the higher one, m above the ellipsoid
rpc.no_overlap: the two models see no common part of the image
    -> lines and samples of the checked one run from {mine}; compare models of one image
rpc.compensation_kind: no such compensation
    -> choose one of {known}
rpc.few_control: too few control points for this compensation
    -> it needs {least}; measure more, or take a simpler one
rpc.control_spread: the control points do not determine this compensation
    -> they lie on one line of the image: measure others beside it, or take a simpler one
rpc.equations: no such equations
    -> choose one of {known}
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
""")
