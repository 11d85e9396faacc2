"""Figures of a result folder for papers: every chart as SVG and PDF, with captions, in one folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final, TypeVar

from fg_orient.formats.atomic import Contents, require_free, staged_folder, writing
from fg_orient.model.errors import InputError
from fg_orient.model.names import Progress
from fg_orient.report import maps, paper, plots, tables
from fg_orient.report.chart import Chart
from fg_orient.report.words import printable, scientific
from fg_orient.result.record import Result, read_result

__all__ = ["write_figures"]

W = TypeVar("W")

FORMATS: Final = ("svg", "pdf")
CAPTIONS_FILE: Final = "captions.md"
#: Content of a folder of figures; the captions are its mark.
FIGURES: Final = Contents(CAPTIONS_FILE, (CAPTIONS_FILE, "*.svg", "*.pdf"))
#: Folder of the figures inside a result folder.
FOLDER: Final = "figures"
#: Images whose own figures are drawn; the tables hold all.
MAX_IMAGES: Final = 12
#: Points of a map, vectors of an image and quantiles of a curve that a paper shows.
MANY: Final = {"map": 5000, "vectors": 2000, "quantiles": 2000}


@dataclass(frozen=True)
class Plot:
    """One kind of figure.

    Parameters
    ----------
    name : str
        File name without its ending.
    caption : str
        ``{images}`` stands for their ids.
    absent : str
        Why a result may have no such figure.
    draw : callable
        Charts of a result and of some images, None and empty ones left out.
    images : int
        Images that share one figure; 0: one figure of the whole block.
    """

    name: str
    caption: str
    absent: str
    draw: Callable[[Result, list[str]], Sequence[Chart | None]]
    images: int = 0


def _residuals(kind: Callable[..., Chart | None], **more: int) -> Callable[[Result, list[str]], list[Chart | None]]:
    """Charts of the normalised residuals of each image."""

    def charts(result: Result, images: list[str]) -> list[Chart | None]:
        ratio, tested = result.normalised
        return [kind(ratio[result.rows[name]], name, tested, **more) for name in images]

    return charts


def _map(result: Result, images: list[str], up: bool = False) -> list[Chart | None]:
    known = result.points.numbers("lon_deg", "difference_east_m")
    some = not up or bool((known == known).all(axis=1).any())
    return [maps.point_map(result, up=up, most=MANY["map"])] if some else []


def _corrections(result: Result, images: list[str]) -> list[Chart | None]:
    return [plots.correction_chart(**one) for one in tables.corrections(result) if one["image"] in images]


def _correlations(result: Result, images: list[str]) -> list[Chart | None]:
    names, rho = tables.short_names(result), tables.image_correlations(result)
    return [plots.heat_map(f"image {name}", names[name], rho[name]) for name in images if name in rho]


def _redundancy(result: Result, images: list[str]) -> list[Chart | None]:
    table = result.residuals
    return [
        plots.redundancy_chart(table.numbers("redundancy_line", "redundancy_sample")),
        plots.detectable_chart(table.numbers("mdb_line_px", "mdb_sample_px"), result.record.get("reliability") or {}),
    ]


PLOTS: Final = (
    Plot("map", "Points with footprints of the images (dashed) and the horizontal differences adjusted minus measured "
         "of control (triangles) and check points (circles); the bars are the scales of the ground and of the "
         "differences.", "the points have no geographic coordinates", _map),
    Plot("map_up", "Differences in height, adjusted minus measured, at control and check points; a bar upwards means "
         "that the adjusted point is too high.", "no located point has a difference of its coordinates",
         partial(_map, up=True)),
    Plot("residuals", "Residuals of the image points, adjusted minus observed, in the images {images}; lines run "
         "downwards.", "there are no image points",
         lambda result, images: [plots.residual_vectors(result, name, MANY["vectors"]) for name in images], 2),
    Plot("histograms", "Normalised residuals of the image points of {images}, by line and sample, with the normal "
         "curve; mean and root mean square about it (s) in the legend. The outermost bins hold all values beyond the "
         "axis.", "there are no residuals with a standard deviation", _residuals(plots.histogram), 2),
    Plot("quantiles", "Ordered normalised residuals of {images} over the quantiles of the normal distribution. Each of "
         "n independent normal values lies in the grey band with 95 %; residuals are correlated, so the band is a "
         "guide.", "there are no residuals with a standard deviation",
         _residuals(plots.quantiles, most=MANY["quantiles"]), 2),
    Plot("corrections", "Corrections of the orientation of {images} with their standard deviations (bars), in prior "
         "standard deviations where there are priors (dashed: ±1); the values beside them are in the units named. τ "
         "runs from −1 (first line) to +1 (last line).", "the images have no unknowns", _corrections, 2),
    Plot("correlations", "Correlations of the adjusted orientation unknowns within {images}. τ: time of the line; X, "
         "Y, Z: position, vX, vY, vZ: velocity.", "the covariances are unavailable; result.json gives the reason",
         _correlations, 2),
    Plot("singular_values", "Singular values of the Jacobian of {images}, unknowns in prior standard deviations. From "
         "1 on the data determine a direction. Below 1 the prior determines it (weak). Up to 1e−5 the data contain no "
         "information about it (dead).", "no image has unknowns",
         lambda result, images: [plots.singular_values([o for o in result.record["observability"]
                                                        if str(o["image"]) in images])], MAX_IMAGES),
    Plot("redundancy", "Redundancy numbers of the image points, and the share of image points whose error of a given "
         "size is detected: points without a minimal detectable bias count as never detected.",
         "redundancy numbers are unavailable; result.json gives the reason", _redundancy),
    Plot("l_curve", "L-curve of the equations at the start values: norm of the Tikhonov solutions (prior standard "
         "deviations of the image unknowns and metres of the ground points) over that of their residuals (standard "
         "deviations), for all κ. The filled circle is the choice of the solver, hollow squares are those of other "
         "rules.", "no solver with a regularisation parameter was used, such as tikhonov_l_curve of the dense backend",
         lambda result, _: [plots.l_curve(result.record.get("regularisation"))]),
    Plot("iterations", "Weighted sum of squares (twice the cost under a loss) and largest step by iteration; steps are "
         "in prior standard deviations (images) and metres (points).", "the optimiser keeps no log",
         lambda result, _: plots.iteration_charts(result.iterations)),
)  # fmt: skip


def planned(result: Result) -> list[tuple[str, Plot, list[str]]]:
    """File name, plot and ids of the images of every figure that is tried."""
    chosen, out = result.images[:MAX_IMAGES], []
    for plot in PLOTS:
        step = plot.images or max(len(chosen), 1)
        groups = [chosen[k : k + step] for k in range(0, len(chosen), step)] if plot.images else [chosen]
        names = [plot.name] if len(groups) == 1 else [f"{plot.name}_{k:02d}" for k in range(1, len(groups) + 1)]
        out += [(name, plot, group) for name, group in zip(names, groups, strict=True)]
    return out


def write_figures(
    folder: str | Path, out: str | Path | None = None, *, overwrite: bool = False, formats: Sequence[str] = FORMATS,
    progress: Progress | None = None,
) -> tuple[Path, list[str]]:  # fmt: skip
    """Write all figures of a result folder, whole or not at all.

    Parameters
    ----------
    folder : path
        Result folder of ``adjust``.
    out : path, optional
        Folder to come; default ``figures`` inside the result folder.
    overwrite : bool
        Replace a folder of figures.
    formats : sequence of str
        ``svg``, ``pdf``.
    progress : callable, optional
        Called with (done, of, text) after each figure.

    Returns
    -------
    path : Path
        The folder written.
    names : list of str
        Its files.

    Raises
    ------
    InputError
        The folder holds no result, matplotlib is missing, or the output may not be written.
    """
    require_matplotlib()
    if unknown := [kind for kind in formats if kind not in FORMATS]:
        raise InputError.of("options.value", place="formats", value=unknown[0], expected=" or ".join(FORMATS))
    result = read_result(Path(folder))
    target = target_of(folder, out, overwrite)
    drawn = {name: partial(_drawn, result, plot, images) for name, plot, images in planned(result)}
    files, facts = draw_figures(drawn, formats, progress)
    return target, write_files(target, files, captions(result, facts), overwrite=overwrite)


def require_matplotlib() -> None:
    """Raise InputError without matplotlib."""
    if not paper.available():
        raise InputError.of("report.no_matplotlib", option="figures")


def target_of(folder: str | Path, out: str | Path | None, overwrite: bool) -> Path:
    """Folder of the figures of a result folder; raise InputError if it may not be written."""
    target = Path(folder) / FOLDER if out is None else Path(out)
    require_free(target, overwrite=overwrite, contents=FIGURES)
    return target


def write_files(target: Path, files: Mapping[str, bytes], words: str, *, overwrite: bool) -> list[str]:
    """Write drawings and the page of their captions, whole or not at all; names of the files."""
    with staged_folder(target, overwrite=overwrite, contents=FIGURES) as staged, writing(target):
        for name, data in files.items():
            (staged / name).write_bytes(data)
        (staged / CAPTIONS_FILE).write_text(words, encoding="utf-8")
    return sorted([*files, CAPTIONS_FILE])


def draw_figures(
    drawn: Mapping[str, Callable[[], tuple[Sequence[Chart | None], W]]], formats: Sequence[str],
    progress: Progress | None,
) -> tuple[dict[str, bytes], dict[str, W]]:  # fmt: skip
    """Draw charts in the style of papers: bytes by file name, and the facts for the captions by name of figure."""
    import matplotlib

    files: dict[str, bytes] = {}
    facts: dict[str, W] = {}
    with matplotlib.rc_context(paper.STYLE):
        for done, (name, draw) in enumerate(drawn.items(), start=1):
            charts, fact = draw()
            if given := [chart for chart in charts if chart is not None]:
                facts[name] = fact
                figure = paper.figure_of(given)
                files |= {f"{name}.{kind}": paper.file_of(figure, kind) for kind in formats}
            if progress is not None:
                progress(done, len(drawn), "figures")
    return files, facts


def _drawn(result: Result, plot: Plot, images: list[str]) -> tuple[Sequence[Chart | None], tuple[Plot, list[str]]]:
    return plot.draw(result, images), (plot, images)


def captions(result: Result, drawn: Mapping[str, tuple[Plot, list[str]]]) -> str:
    """Captions as Markdown, in the order of the figures, and the reasons of those that are missing.

    Parameters
    ----------
    result : Result
    drawn : mapping
        Name of each figure to its plot and the ids of its images.
    """
    lines = [f"# Figures of {_plain(result.record['name'])}", ""]
    for name, (plot, images) in drawn.items():
        listed = ", ".join(_plain(image) for image in images)
        lines += [f"**{name}** {plot.caption.replace('{images}', listed)}{_remarks(result, plot.name, images)}", ""]
    missing = [plot for plot in PLOTS if plot.name not in {plot.name for plot, _ in drawn.values()}]
    if missing:
        lines += ["Not drawn:", "", *(f"- {plot.name}: {plot.absent}" for plot in missing), ""]
    left_out = len(result.images) - len({image for _, images in drawn.values() for image in images})
    if left_out > 0 and drawn:
        lines += [f"{left_out} more images have no figures of their own; the tables of the result hold them.", ""]
    return "\n".join(lines)


def _remarks(result: Result, plot: str, images: list[str]) -> str:
    """Sentences on this result."""
    record, out = result.record, ""
    if plot in ("histograms", "quantiles"):
        if record.get("robust"):
            out += f" Under the loss {record['loss']} they are not normal."
        elif record.get("variance_components"):
            out += " The standard deviations were estimated from these residuals."
    if plot == "corrections":
        scale = set(filter(None, result.eop.words["sigma_scale"]))
        out += f" Standard deviations in {' and '.join(sorted(scale))} scale." if scale else ""
    if plot == "l_curve":
        rules = (r for r in plots.ranked(record["regularisation"]) if r["kappa"] is not None)
        listed = (f"{r['number']} {_plain(r['label'])}: κ = {scientific(r['kappa'])}" for r in rules)
        out += f" {', '.join(listed)}."
    if plot == "singular_values":
        told = [s for o in record["observability"] if str(o["image"]) in images for s in o["sentences"]]
        out += "".join(f" {_plain(sentence).rstrip('.')}." for sentence in told)
    return out


def _plain(text: object) -> str:
    """Text without control characters, with the marks of Markdown and HTML escaped."""
    return "".join(f"\\{c}" if c in "\\`*_[]<>#|" else c for c in printable(text))
