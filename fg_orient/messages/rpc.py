"""Messages of rational function models (RPC): the model itself and its files."""

from __future__ import annotations

from typing import Final

RPC: Final = {
    "rpc.shape": ("the array must have the shape {shape}", "give 5 offsets, 5 scales and 4 x 20 coefficients"),
    "rpc.not_finite": ("a value is not finite", "use the original file"),
    "rpc.zero_scale": ("a scale of zero", "use the original file; a scale is half the range of its coordinate"),
    "rpc.denominator_constant": (
        "the constant of a denominator must be 1",
        "divide all 40 coefficients of this coordinate by it",
    ),
    "rpc.pole": (
        "the denominator is not positive everywhere inside the image: the model fails near there",
        "fit it again with fewer or regularised coefficients; in Python RpcSensor(model, poles=True) takes it as it is",
    ),
    "rpc.outside": (
        "the point lies outside the validity range of the model",
        "valid: longitude {lon}, latitude {lat}, height {height} m; check the order of the coordinates",
    ),
    "rpc.no_direct": (
        "the file holds no coefficients from image to ground",
        "use locate(), which inverts the projection by iteration",
    ),
    "rpc.no_ground": (
        "the pixel has no ground point at this height",
        "the model is valid for heights of {height} m (ellipsoidal)",
    ),
    "rpc.compensation": (
        "compensation needs {count} finite numbers",
        "give pixels: shift, drift with the line, drift with the sample, each of line and sample",
    ),
    "rpc.coefficient_count": ("needs 20 coefficients, {count} given", "use the original file"),
    "rpc.list_count": (
        "a list of RPC holds 90 numbers",
        "give 5 offsets, 5 scales (line, sample, latitude, longitude, height) and 4 x 20 coefficients",
    ),
    "rpc.missing": ("{field} is missing", "use the complete RPC file of the product"),
    "rpc.doubled": ("{field} is given twice", "remove the wrong one"),
    "rpc.not_a_number": ("not a plain finite number", "write it as 123.456 or 1.23e-4, with a decimal point"),
    "rpc.syntax": ("the line cannot be understood", "write {expected}"),
    "rpc.order": (
        "the coefficients are in the order {found}, not {asked}",
        "if the file is right, say so: --order {found}, or read_rpc(path, order='{found}')",
    ),
    "rpc.unknown_order": ("no such order of coefficients", "choose one of {known}"),
    "rpc.origin": (
        "a plain list of numbers does not say which pixel coordinate the first pixel has",
        "say it: --first-pixel 0, or 1 for Pléiades; in Python read_rpc(path, first_pixel=0)",
    ),
    "rpc.unknown_format": (
        "this is no RPC file that can be read",
        "choose one of {known}",
    ),
    "rpc.no_tags": ("the image holds no RPC", "give the RPC file that lies beside it"),
    "rpc.no_rasterio": ("RPC in images need rasterio", "install the extra: pip install 'fg-orient[geo]'"),
    "rpc.unreadable": ("the file cannot be read", "give a readable file"),
    "rpc.tags_target": (
        "RPC tags are written into an existing GeoTIFF",
        "give the image itself, or a name that ends with _RPC.TXT, .RPB or .XML",
    ),
    "rpc.target_name": ("no such format to write", "choose one of {known}"),
    "rpc.sidecar": (
        "an RPC file beside the image would hide its tags: GDAL prefers the file",
        "move it away, or write it instead of the tags",
    ),
    "rpc.role": ("unknown role", "write control or check"),
    "rpc.sigma": ("a sigma must be positive", "give the standard deviation of the measurement, pixels"),
    "rpc.heights": ("this is no range of heights", "give the lower and the higher one, m above the ellipsoid"),
    "rpc.no_overlap": (
        "the two models see no common part of the image",
        "lines and samples of the checked one run from {mine}; compare models of one image",
    ),
    "rpc.compensation_kind": ("no such compensation", "choose one of {known}"),
    "rpc.few_control": (
        "too few control points for this compensation",
        "it needs {least}; measure more, or take a simpler one",
    ),
    "rpc.control_spread": (
        "the control points do not determine this compensation",
        "they lie on one line of the image: measure others beside it, or take a simpler one",
    ),
    "rpc.equations": ("no such equations", "choose one of {known}"),
    "rpc.solver_form": ("a solver is chosen for the linear form only", "add --equations linear"),
    "rpc.unscaled": (
        "coefficients without normalisation are not written: formats state their ranges by offset and scale",
        "leave out --out or --no-normalise",
    ),
    "rpc.no_heights": (
        "a fit to a sensor needs heights",
        "give --heights LOW HIGH, m above the ellipsoid",
    ),
    "rpc.foreign_option": ("{option} does not apply to {source}", "leave it out"),
    "rpc.target": ("the name does not say in which format to write", "end it with _RPC.TXT, .RPB, .XML or .TIF"),
}
