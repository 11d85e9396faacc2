"""Captions of the figures: what each shows, with the numbers that belong to it, and what was not drawn and why."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from fg_orient.report.figure_data import Folder
from fg_orient.report.l_curve import ranked
from fg_orient.report.words import printable, scientific

#: What each figure shows. Sentences stand in a paper as they are.
TEXTS: Final = {
    "map": "Points with footprints of the images (lines) and the horizontal differences adjusted minus measured of "
    "control (triangles) and check points (circles); the vector at the lower right is the scale of the differences.",
    "map_up": "Differences in height, adjusted minus measured, at control and check points; a bar upwards means that "
    "the adjusted point is too high.",
    "residuals": "Residuals of the image points, adjusted minus observed, in the images {images}; lines run downwards.",
    "histograms": "Normalised residuals of the image points of {images}, by line and sample, with the normal density; "
    "n, mean and root mean square about it (s) in the legend. Values beyond the axis stand in the outermost bins.",
    "quantiles": "Ordered normalised residuals of {images} over the quantiles of the normal distribution. Each of n "
    "independent normal values lies in the grey band with 95 %; residuals are correlated, so the band is a guide.",
    "corrections": "Corrections of the orientation of {images} with their standard deviations (bars), in prior "
    "standard deviations where there are priors; the values beside them are in the units named. τ runs from −1 (first "
    "line) to +1 (last line).",
    "correlations": "Correlations of the adjusted orientation unknowns within {images}. τ: time of the line; X, Y, Z: "
    "position, vX, vY, vZ: velocity.",
    "singular_values": "Singular values of the Jacobian of {images}, unknowns in prior standard deviations. From 1 on "
    "the data determine a direction, below 1 the prior holds it (weak), up to 1e−5 the data say nothing (dead).",
    "redundancy": "Redundancy numbers of the image points, and the share of image points whose error of a given size "
    "is found: points without a minimal detectable bias count as never found.",
    "l_curve": "L-curve of the equations at the start values: norm of the Tikhonov solutions (prior standard "
    "deviations of the image unknowns and metres of the ground points) over that of their residuals (standard "
    "deviations), for all κ. The filled circle is the choice of the solver, hollow squares are those of other rules.",
    "iterations": "Weighted sum of squares (twice the cost under a loss) and largest step by iteration; steps are in "
    "prior standard deviations (images) and metres (points).",
}
#: Why a figure is not there.
ABSENT: Final = {
    "map": "the points have no geographic coordinates",
    "map_up": "no located point has a difference of its coordinates",
    "residuals": "there are no image points",
    "histograms": "there are no residuals with a standard deviation",
    "quantiles": "there are no residuals with a standard deviation",
    "corrections": "the images have no unknowns",
    "correlations": "the covariances are withheld; the warnings of result.json say why",
    "singular_values": "no image has unknowns",
    "redundancy": "redundancy numbers are withheld; the warnings of result.json say why",
    "l_curve": "no solver with a regularisation parameter was used, such as tikhonov_l_curve of the dense backend",
    "iterations": "the optimiser keeps no log",
}


def page(folder: Folder, drawn: Mapping[str, tuple[str, list[str]]]) -> str:
    """Captions as Markdown, in the order of the figures.

    Parameters
    ----------
    folder : Folder
    drawn : mapping
        Name of each figure to its plot and the ids of its images.
    """
    lines = [f"# Figures of {_plain(folder.record['name'])}", ""]
    for name, (plot, images) in drawn.items():
        listed = ", ".join(_plain(image) for image in images)
        lines += [f"**{name}** {TEXTS[plot].replace('{images}', listed)}{_remarks(folder, plot, images)}", ""]
    missing = [plot for plot in TEXTS if plot not in {plot for plot, _ in drawn.values()}]
    if missing:
        lines += ["Not drawn:", "", *(f"- {plot}: {ABSENT[plot]}" for plot in missing), ""]
    left_out = len(folder.images) - len({image for _, images in drawn.values() for image in images})
    if left_out > 0 and drawn:
        lines += [f"{left_out} more images have no figures of their own; the tables of the result hold them.", ""]
    return "\n".join(lines)


def _remarks(folder: Folder, plot: str, images: list[str]) -> str:
    """What a reader must know of this result."""
    out = ""
    if plot in ("histograms", "quantiles"):
        if folder.record.get("robust"):
            out += f" Under the loss {folder.record['loss']} they are not normal."
        elif folder.record.get("variance_components"):
            out += " The standard deviations were estimated from these residuals."
    if plot == "corrections":
        scale = set(filter(None, folder.result.eop.words["sigma_scale"]))
        out += f" Standard deviations in {' and '.join(sorted(scale))} scale." if scale else ""
    if plot == "l_curve":
        rules = (r for r in ranked(folder.record["regularisation"]) if r["kappa"] is not None)
        listed = (f"{r['number']} {_plain(r['label'])}: κ = {scientific(r['kappa'])}" for r in rules)
        out += f" {', '.join(listed)}."
    if plot == "singular_values":
        found = [s for o in folder.record["observability"] if str(o["image"]) in images for s in o["sentences"]]
        out += "".join(f" {_plain(sentence).rstrip('.')}." for sentence in found)
    return out


def _plain(text: object) -> str:
    """Words of others without control characters and marks of Markdown or HTML."""
    return "".join(f"\\{c}" if c in "\\`*_[]<>#|" else c for c in printable(text))
