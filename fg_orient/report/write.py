"""All figures of a result folder, written into one folder of SVG and PDF files with their captions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeVar

from fg_orient.formats.atomic import Contents, require_free, staged_folder, writing
from fg_orient.model.errors import InputError
from fg_orient.model.names import Progress
from fg_orient.report import captions, checks, maps, regularisation, residuals, style
from fg_orient.report import figure_orientation as orientation
from fg_orient.report.figure_data import Folder, read_folder

if TYPE_CHECKING:
    from matplotlib.figure import Figure

W = TypeVar("W")

FORMATS: Final = ("svg", "pdf")
CAPTIONS_FILE: Final = "captions.md"
#: What a folder of figures holds; the captions are its mark.
FIGURES: Final = Contents(CAPTIONS_FILE, (CAPTIONS_FILE, "*.svg", "*.pdf"))
#: Folder of the figures inside a result folder.
FOLDER: Final = "figures"
#: Images whose own figures are drawn; the tables hold all.
MAX_IMAGES: Final = 12


@dataclass(frozen=True)
class Plot:
    """One kind of figure.

    Parameters
    ----------
    name : str
        File name without its ending.
    draw : callable
        Gives the figure of a folder and some images, or None where the result holds nothing to draw.
    images : int
        Images that share one figure; 0: one figure of the whole block.
    """

    name: str
    draw: Callable[[Folder, list[str]], Figure | None]
    images: int = 0


PLOTS: Final = (
    Plot("map", lambda folder, _: maps.error_map(folder)),
    Plot("map_up", lambda folder, _: maps.error_map(folder, up=True) if maps.has_errors(folder) else None),
    Plot("residuals", residuals.vectors, 2),
    Plot("histograms", residuals.histograms, 2),
    Plot("quantiles", residuals.quantiles, 2),
    Plot("corrections", orientation.corrections, 2),
    Plot("correlations", orientation.correlations, 2),
    Plot("singular_values", orientation.singular_values, 4),
    Plot("redundancy", checks.redundancy),
    Plot("l_curve", lambda folder, _: regularisation.l_curve(folder)),
    Plot("iterations", checks.iterations),
)


def planned(folder: Folder) -> list[tuple[str, Plot, list[str]]]:
    """File name, plot and ids of the images of every figure that is tried."""
    chosen, out = folder.images[:MAX_IMAGES], []
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
    target = Path(folder) / FOLDER if out is None else Path(out)
    if not style.available():
        raise InputError.of("report.no_matplotlib", option="figures")
    if unknown := [kind for kind in formats if kind not in FORMATS]:
        raise InputError.of("options.value", place="formats", value=unknown[0], expected=" or ".join(FORMATS))
    given = read_folder(Path(folder))
    require_free(target, overwrite=overwrite, contents=FIGURES)
    plots = {name: partial(_draw, given, plot, images) for name, plot, images in planned(given)}
    files, told = draw_figures(plots, formats, progress)
    return target, write_files(target, files, captions.page(given, told), overwrite=overwrite)


def write_files(target: Path, files: Mapping[str, bytes], words: str, *, overwrite: bool) -> list[str]:
    """Write drawings and the page of their captions, whole or not at all; names of the files."""
    with staged_folder(target, overwrite=overwrite, contents=FIGURES) as staged, writing(target):
        for name, data in files.items():
            (staged / name).write_bytes(data)
        (staged / CAPTIONS_FILE).write_text(words, encoding="utf-8")
    return sorted([*files, CAPTIONS_FILE])


def draw_figures(
    plots: Mapping[str, Callable[[], tuple[Figure, W] | None]], formats: Sequence[str], progress: Progress | None
) -> tuple[dict[str, bytes], dict[str, W]]:
    """Draw figures in the style of papers: bytes by file name; what the captions are made of, by name of figure."""
    import matplotlib

    files: dict[str, bytes] = {}
    told: dict[str, W] = {}
    with matplotlib.rc_context(style.STYLE):
        for done, (name, draw) in enumerate(plots.items(), start=1):
            found = draw()
            if found is not None:
                figure, told[name] = found
                files |= {f"{name}.{kind}": style.file_of(figure, kind) for kind in formats}
            if progress is not None:
                progress(done, len(plots), "figures")
    return files, told


def _draw(folder: Folder, plot: Plot, images: list[str]) -> tuple[Figure, tuple[str, list[str]]] | None:
    """Draw a plot of some images, with its name and these."""
    figure = plot.draw(folder, images)
    return None if figure is None else (figure, (plot.name, images))
