"""Figures of a result folder for papers: all charts as SVG and PDF, with captions."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Final

from fg_orient.formats.atomic import Contents, require_free, staged_folder, writing
from fg_orient.formats.load import foreign_bytes
from fg_orient.model.errors import InputError
from fg_orient.model.jitter import ANGLES
from fg_orient.model.names import Progress
from fg_orient.report import maps, paper, plots, tables
from fg_orient.report.chart import Chart
from fg_orient.report.page import environment
from fg_orient.report.words import printable
from fg_orient.result.record import Result, read_result

__all__ = ["write_figures"]

#: Charts of a figure. A chart without data is None and is not drawn.
Charts = Sequence[Chart | None]
FORMATS: Final = ("svg", "pdf")
CAPTIONS_FILE: Final = "captions.md"
#: Content of a folder of figures. The file of captions identifies such a folder.
FIGURES: Final = Contents(CAPTIONS_FILE, (CAPTIONS_FILE, "*.svg", "*.pdf"))
#: Folder of the figures inside a result folder.
FOLDER: Final = "figures"
#: Maximum number of images with figures; the tables contain all.
MAX_IMAGES: Final = 12
#: Maximum numbers on paper: points of a map, vectors of an image, quantiles of a curve.
MANY: Final = {"map": 5000, "vectors": 2000, "quantiles": 2000}


def _residuals(kind: Callable[..., Chart | None], **more: int) -> Callable[[Result, list[str]], Charts]:
    """Return the charts of the normalised residuals of each image."""

    def charts(result: Result, images: list[str]) -> Charts:
        ratio, tested = result.normalised
        return [kind(ratio[result.rows[name]], name, tested, **more) for name in images]

    return charts


def _map(result: Result, images: list[str], up: bool = False) -> Charts:
    known = result.points.numbers("lon_deg", "difference_east_m")
    some = not up or bool((known == known).all(axis=1).any())
    return [maps.point_map(result, up=up, most=MANY["map"])] if some else []


def _corrections(result: Result, images: list[str]) -> Charts:
    return [plots.correction_chart(**one) for one in tables.corrections(result) if one["image"] in images]


def _correlations(result: Result, images: list[str]) -> Charts:
    names, rho = tables.short_names(result), tables.image_correlations(result)
    return [plots.heat_map(f"image {name}", names[name], rho[name]) for name in images if name in rho]


def _redundancy(result: Result, images: list[str]) -> Charts:
    table = result.residuals
    return [
        plots.redundancy_chart(table.numbers("redundancy_line", "redundancy_sample")),
        plots.detectable_chart(table.numbers("mdb_line_px", "mdb_sample_px"), result.record.get("reliability") or {}),
    ]


#: Kinds of figures: number of images that share a figure (0: one figure of the whole block), and a function
#: that returns the charts of some images of a result. Captions, and reasons why a result may have no such
#: figure: ``captions.md.j2``.
PLOTS: Final[dict[str, tuple[int, Callable[[Result, list[str]], Charts]]]] = {
    "map": (0, _map),
    "map_up": (0, partial(_map, up=True)),
    "residuals": (2, lambda result, images: [plots.residual_vectors(result, name, MANY["vectors"]) for name in images]),
    "histograms": (2, _residuals(plots.histogram)),
    "quantiles": (2, _residuals(plots.quantiles, most=MANY["quantiles"])),
    "corrections": (2, _corrections),
    "correlations": (2, _correlations),
    "jitter": (2, lambda result, images: [
        plots.jitter_chart(result, name, angle) for name in images for angle in ANGLES]),
    "singular_values": (MAX_IMAGES, lambda result, images: [
        plots.singular_values([o for o in result.record["observability"] if str(o["image"]) in images])]),
    "redundancy": (0, _redundancy),
    "l_curve": (0, lambda result, _: [plots.l_curve(result.record.get("regularisation"))]),
    "iterations": (0, lambda result, _: plots.iteration_charts(result.iterations)),
}  # fmt: skip


def planned(result: Result) -> list[tuple[str, str, list[str]]]:
    """Return file name, kind and image ids of each figure that may be drawn."""
    chosen, out = result.images[:MAX_IMAGES], []
    for kind, (step, _) in PLOTS.items():
        groups = [chosen[k : k + step] for k in range(0, len(chosen), step)] if step else [chosen]
        names = [kind] if len(groups) == 1 else [f"{kind}_{k:02d}" for k in range(1, len(groups) + 1)]
        out += [(name, kind, group) for name, group in zip(names, groups, strict=True)]
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
        Folder to create; default ``figures`` inside the result folder.
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
        The folder contains no result, matplotlib is missing, or the output may not be written.
    """
    require_matplotlib()
    if unknown := [kind for kind in formats if kind not in FORMATS]:
        raise InputError.of("options.value", place="formats", value=unknown[0], expected=" or ".join(FORMATS))
    result = read_result(Path(folder))
    with foreign_bytes("report.damaged", folder):
        tried = planned(result)
        charts = {name: partial(PLOTS[kind][1], result, images) for name, kind, images in tried}
        return draw_figures(
            charts, lambda drawn: captions(result, [one for one in tried if one[0] in drawn]),
            out or Path(folder) / FOLDER, overwrite=overwrite, formats=formats, progress=progress,
        )  # fmt: skip


def require_matplotlib() -> None:
    """Raise InputError without matplotlib."""
    if not paper.available():
        raise InputError.of("report.no_matplotlib", option="figures")


def draw_figures(
    charts: Mapping[str, Callable[[], Charts]], captions: Callable[[Collection[str]], str], out: str | Path, *,
    overwrite: bool, formats: Sequence[str] = FORMATS, progress: Progress | None = None,
    contents: Contents = FIGURES, more: Mapping[str, bytes] | None = None,
) -> tuple[Path, list[str]]:  # fmt: skip
    """Draw charts in the style of papers and write them with their captions, whole or not at all.

    Parameters
    ----------
    charts : mapping
        Name of each figure to the function that makes its charts.
    captions : callable
        Text of the captions for the names of the figures that have charts.
    out, overwrite, formats, progress
        See :func:`write_figures`.
    contents : Contents
        Files that the folder may have.
    more : mapping, optional
        Bytes of further files by name.
    """
    import matplotlib

    target, files, drawn = Path(out), dict(more or {}), list[str]()
    require_free(target, overwrite=overwrite, contents=contents)
    with matplotlib.rc_context(paper.STYLE):
        for done, (name, draw) in enumerate(charts.items(), start=1):
            if given := [chart for chart in draw() if chart is not None]:
                drawn.append(name)
                figure = paper.figure_of(given)
                files |= {f"{name}.{kind}": paper.file_of(figure, kind) for kind in formats}
            if progress is not None:
                progress(done, len(charts), "figures")
    files[CAPTIONS_FILE] = captions(drawn).encode()
    with staged_folder(target, overwrite=overwrite, contents=contents) as staged, writing(target):
        for name, data in files.items():
            (staged / name).write_bytes(data)
    return target, sorted(files)


def captions(result: Result, drawn: Sequence[tuple[str, str, list[str]]]) -> str:
    """Return captions as Markdown, in the order of the figures, and the reasons for missing figures.

    Parameters
    ----------
    result : Result
    drawn : sequence of (str, str, list of str)
        File name, kind and ids of the images of each figure that was drawn.
    """
    pages = environment()
    pages.filters["markdown"] = _markdown
    section, kinds = result.record.get("regularisation"), {kind for _, kind, _ in drawn}
    text = pages.get_template("captions.md.j2").render(
        r=result.record, drawn=drawn, missing=[kind for kind in PLOTS if kind not in kinds],
        left_out=len(result.images) - len({image for _, _, images in drawn for image in images}),
        scales=sorted(set(filter(None, result.eop.words["sigma_scale"]))),
        rules=[rule for rule in plots.ranked(section) if rule["kappa"] is not None] if section else [],
    )  # fmt: skip
    return text.rstrip("\n") + "\n"


def _markdown(text: object) -> str:
    """Return the text without control characters, with the markup of Markdown and HTML escaped."""
    return "".join(f"\\{c}" if c in "\\`*_[]<>#|" else c for c in printable(text))
