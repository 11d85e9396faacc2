"""Charts of an adjustment for page and paper. A function returns None if the result has no data for its chart."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from factors.arrays import Array, Index
from fg_orient.model.distributions import beta_quantile, normal_probability, normal_quantile
from fg_orient.report.chart import SERIES, Axis, Chart, Picture, broad, cut, decades, large, limits_of, round_down
from fg_orient.report.maps import image_view
from fg_orient.report.words import number
from fg_orient.result.record import Result

#: Maximum number of vectors of an image and of quantiles on a page; a paper shows more.
MAX_VECTORS: Final = 400
MAX_QUANTILES: Final = 120
#: Maximum number of images with residuals or correlations on a page.
MAX_PANELS: Final = 16
#: Maximum number of images with singular values; the table lists all.
MAX_IMAGES: Final = 40
#: Length of a large vector (90 % quantile) as a share of the width of an image.
IMAGE_SHARE: Final = 0.09
#: If an image has more vectors than this, they are drawn shorter.
_FEW: Final = 100
#: Limit of the axis of normalised residuals. A sentence gives the number of values beyond it.
ENDS: Final = 5.0
#: Smallest singular value of the axis.
FLOOR: Final = 1e-8
#: If biases differ by more than this factor, their axis is logarithmic.
WIDE: Final = 8.0
#: Choices of kappa that are closer than this share of the frame get one common number.
NEAR: Final = 0.03
#: Norms of the L-curve of an adjustment.
NORMS: Final = ("norm of the residuals |Ax − l|, σ", "norm of the solution |x|, prior σ and m")
LINE_SAMPLE: Final = ("line", "sample")
#: Texts for residuals divided by the standard deviations of the observations, and by their own standard deviations.
_NORMALISED: Final = ("residual v/σ", "w = v/(σ√r)")
_DEGREE: Final = {"": "", "constant": "", "linear": " · τ", "quadratic": " · τ²"}


# --- residuals -------------------------------------------------------------------------------------


def residual_vectors(result: Result, image: str, most: int | None = None) -> Chart | None:
    """Return the chart of the residual vectors in an image, or in the part with points, with lines downwards."""
    rows = result.rows[image]
    if not len(rows):
        return None
    facts = next(facts for facts in result.record["images"] if str(facts["id"]) == image)
    place, v = (result.residuals.numbers(*of, rows=rows) for of in (("sample", "line"), ("v_sample_px", "v_line_px")))
    drawn = thinned(np.arange(len(rows)), v, MAX_VECTORS if most is None else most)
    size = np.array([float(facts["n_samples"] or 0), float(facts["n_lines"] or 0)])
    view = image_view(place, size)
    whole = np.stack([np.minimum(0.0, place.min(axis=0)), np.maximum(size, place.max(axis=0))])
    limits = (whole if view is None else view).T
    chart = vectors(f"residual vectors of image {image}", place[drawn], v[drawn], limits, ("sample, px", "line, px"),
                    reference=v, unit=" px")  # fmt: skip
    more = f", {len(drawn)} of {len(rows)} drawn" if len(drawn) < len(rows) else ""
    chart.title = f"{cut(image)} ({len(rows)} points{more})"
    return chart


def vectors(
    words: str, place: Array, v: Array, limits: Array, axes: tuple[str, str], *, reference: Array, unit: str = "",
    down: bool = True,
) -> Chart:  # fmt: skip
    """Return a chart of vectors (n, 2) at places (n, 2) of an image, with a scale vector above.

    Parameters
    ----------
    words : str
    place, v : (n, 2) arrays
        Positions and vectors: x, then y.
    limits : (2, 2) array
        Limits of x and of y.
    axes : (str, str)
    reference : (m, 2) array
        Vectors that determine the scale by their large lengths.
    unit : str
        Unit of the vectors, with a leading space.
    down : bool
        True if y increases downwards.
    """
    (x, y) = (Axis(name, (float(low), float(high)), about=k) for name, (low, high), k in zip(
        axes, limits.tolist(), (3, 4), strict=True))  # fmt: skip
    share = IMAGE_SHARE * min(1.0, math.sqrt(_FEW / max(len(place), 1)))
    chart = Chart(words, x, replace(y, down=down), aspect=1.0, per_width=large(reference) / share)
    chart.add("dots", "dot-foot", *place.T)
    chart.add("dots", "residual", *place.T, vectors=v, sizes=np.zeros(len(place)))
    if chart.per_width:
        size = round_down(0.25 * chart.per_width)
        chart.bars = [(size / chart.per_width, f"{size:g}{unit}")]
    return chart


def thinned(rows: Index, v: Array, most: int) -> Index:
    """Return the rows that are drawn: the largest tenth, and every k-th of the others."""
    if len(rows) <= most:
        return rows
    first = np.zeros(len(rows), bool)
    first[np.argsort(-np.linalg.norm(v[rows], axis=1), kind="stable")[: most // 10]] = True
    others = np.flatnonzero(~first)
    kept = others[:: math.ceil(len(others) / (most - most // 10))]
    return rows[np.sort(np.append(np.flatnonzero(first), kept))]


def histogram(ratio: Array, name: str, tested: bool, axes: tuple[str, str] = LINE_SAMPLE) -> Chart | None:
    """Return the histograms of normalised residuals (n, 2) of two coordinates, with the normal curve."""
    values = ratio[np.isfinite(ratio)]
    n = len(values)
    if not n:
        return None
    width = 0.25 if n > 2000 else 0.5 if n > 60 else 1.0
    edges = np.arange(-ENDS, ENDS + width / 2, width)
    spread = 1.0 if tested or n < 2 else float(np.std(values)) or 1.0
    x = np.linspace(-ENDS, ENDS, 81)
    curve = 0.5 * n * width * np.exp(-0.5 * (x / spread) ** 2) / (spread * math.sqrt(2.0 * math.pi))
    chart = Chart(f"histogram of the residuals of image {name}", Axis(_NORMALISED[tested], (-ENDS, ENDS)),
                  title=cut(name))  # fmt: skip
    highest = float(curve.max())
    for kind, axis, column in zip(("of-line", "of-sample"), axes, ratio.T, strict=True):
        w = column[np.isfinite(column)]
        counts = np.histogram(np.clip(w, -ENDS, ENDS - 1e-9), edges)[0]
        highest = max(highest, float(counts.max(initial=0)))
        spread_words = f": {number(float(w.mean()), 2)} ± {number(float(w.std()), 2)}" if len(w) else ""
        chart.add("bars", kind, edges, counts, label=f"{axis}{spread_words}")
    chart.add("line", "normal", x, curve, label="normal, σ = 1" if tested else f"normal, σ = {spread:.2f}")
    chart.y = Axis(f"count ({n})", (0.0, 1.5 * highest), about=4)
    return chart


def quantiles(
    ratio: Array, name: str, tested: bool, axes: tuple[str, str] = LINE_SAMPLE, most: int = MAX_QUANTILES
) -> Chart | None:
    """Return the chart of ordered normalised residuals (n, 2) over normal quantiles, with a 95 % band."""
    ordered = [np.sort(column[np.isfinite(column)]) for column in ratio.T]
    n = max(map(len, ordered))
    if not n:
        return None
    chart = Chart(f"quantiles of the residuals of image {name} against the normal",
                  Axis("quantile of N(0, 1)", (-ENDS, ENDS)), Axis(_NORMALISED[tested], (-ENDS, ENDS)),
                  title=cut(name))  # fmt: skip
    if n > 1:
        rank = _spread_ranks(n, most)
        low, _, high = normal_band(n, rank)
        x = normal_quantile((rank + 0.5) / n)
        chart.add(
            "area", "band", np.append(x, x[::-1]), np.clip(np.append(low, high[::-1]), -ENDS, ENDS), label="95 % band"
        )
    chart.add("line", "limit", [-ENDS, ENDS], [-ENDS, ENDS])
    for kind, axis, values in zip(("line-dot", "sample-dot"), axes, ordered, strict=True):
        if len(values):
            rank = _spread_ranks(len(values), most)
            chart.add("dots", kind, normal_quantile((rank + 0.5) / len(values)), np.clip(values[rank], -ENDS, ENDS),
                      label=axis)  # fmt: skip
    return chart


def _spread_ranks(n: int, most: int) -> Index:
    """Return ranks at equal distances of the normal quantile, including the extremes."""
    if n <= most:
        return np.arange(n)
    end = float(normal_quantile(0.5 / n))
    share: Array = normal_probability(np.linspace(end, -end, most))
    return np.unique(np.round(np.clip(share * n - 0.5, 0, n - 1)).astype(np.intp))


def normal_band(n: int, rank: Index) -> tuple[Array, Array, Array]:
    """Return lower bound of 95 %, median and upper bound of ordered independent standard normal values.

    The k-th of n ordered uniform values is Beta(k, n + 1 - k) (David and Nagaraja 2003, 2.1). Each single
    value lies inside its bounds with 95 %. All of them together lie inside less often, and residuals are
    correlated.

    Parameters
    ----------
    n : int
    rank : (k,) int array
        Ranks, counted from 0.
    """
    low, middle, high = (normal_quantile(beta_quantile(rank + 1.0, n - rank, p)) for p in (0.025, 0.5, 0.975))
    return low, middle, high


def worst_images(summaries: list[dict[str, Any]]) -> list[str]:
    """Return the images whose vectors a page shows, the largest residual first."""
    return [row["image"] for row in sorted(summaries, key=lambda row: -row["max_ratio"])[:MAX_PANELS]]


def residual_panels(
    result: Result, summaries: list[dict[str, Any]], pictures: Mapping[str, Picture] | None = None
) -> list[dict[str, Any]]:
    """Return the charts of the images with the largest residuals, in the order of the images.

    Parameters
    ----------
    result : Result
    summaries : list of dict
        ``Result.residual_summary``.
    pictures : mapping, optional
        Pictures of images, by image.

    Returns
    -------
    list of dict
        ``image``, ``drawings``, and ``words``: number of normalised residuals beyond the axis; "" for none.
    """
    worst = set(worst_images(summaries))
    out = []
    for name in (row["image"] for row in summaries if row["image"] in worst):
        ratio, tested = result.normalised[0][result.rows[name]], result.normalised[1]
        beyond = int((np.abs(ratio) > ENDS).sum())
        vectors_of_image = residual_vectors(result, name)
        if vectors_of_image is not None:
            vectors_of_image.picture = (pictures or {}).get(name)
        charts = vectors_of_image, histogram(ratio, name, tested), quantiles(ratio, name, tested)
        out.append({"image": name, "drawings": charts, "words": f"{beyond} beyond ±{ENDS:g} σ" if beyond else ""})
    return out


# --- orientation -----------------------------------------------------------------------------------


def correction_chart(image: str, rows: Sequence[dict[str, Any]]) -> Chart | None:
    """Return the chart of an image's corrections with bars of one standard deviation, in prior sigmas.

    Parameters
    ----------
    image : str
    rows : sequence of dict
        ``name``, ``degree``, ``unit``, ``value``, ``sigma``, ``prior``; see
        :func:`fg_orient.report.tables.corrections`.
    """
    unit = "prior" if any(row["prior"] for row in rows) else "sigma"
    share = {k: row["value"] / row[unit] for k, row in enumerate(rows) if row[unit] and row["value"] is not None}
    if not share:
        return None
    sigma = {k: (rows[k]["sigma"] or 0.0) / rows[k][unit] for k in share}
    reach = 1.05 * max(1.25, *(abs(value) + sigma[k] for k, value in share.items()))
    words = "correction in prior standard deviations, bar ± 1 σ" if unit == "prior" else "correction, own σ"
    chart = broad(
        f"corrections of image {image} in standard deviations", Axis(words, (-reach, reach), about=6),
        Axis(limits=(-0.5, len(rows) - 0.5), down=True, beside=[_value(row) for row in rows],
             names=[row["name"] + _DEGREE.get(row["degree"], f" · {row['degree']}") for row in rows]),
        17.0 * len(rows) + 60.0, title=cut(image), left=190.0, top=10.0,
    )  # fmt: skip
    for edge in (-1.0, 1.0) if unit == "prior" else ():
        chart.upright("limit", edge)
    chart.upright("zero", 0.0)
    for k, value in share.items():
        chart.add("line", "whisker", [value - sigma[k], value + sigma[k]], [k, k])
    chart.add("dots", "line-dot", [*share.values()], [*share])
    return chart


def jitter_chart(result: Result, image: str, angle: str) -> Chart | None:
    """Jitter of an angle (px) with its 95 % band over the lines of the image; None where no jitter was found."""
    table = result.tables.get("jitter")
    if table is None:
        return None
    named = zip(table.words["image"], table.words["component"], strict=True)
    rows = np.array([k for k, one in enumerate(named) if one == (image, angle)], np.intp)
    if not len(rows):
        return None
    line, value, low, high = table.numbers("line", "value_px", "lower_px", "upper_px", rows=rows).T
    reach = 1.05 * float(np.abs([low, high]).max())
    chart = broad(f"jitter of {angle} of image {image} over the lines", Axis("line", (line[0], line[-1])),
                  Axis("jitter, px", (-reach, reach)), title=f"{angle} of {cut(image)}")  # fmt: skip
    chart.add("area", "band", np.append(line, line[::-1]), np.append(low, high[::-1]), label="95 % band")
    chart.across("zero", 0.0)
    chart.add("line", "of-line", line, value, label="estimate")
    return chart


def _value(row: dict[str, Any]) -> str:
    """Return value and sigma with their significant digits."""
    if row["value"] is None:
        return "–"
    if not row["sigma"]:
        return f"{row['value']:.3g} {row['unit']}".replace("-", "−")
    digits = min(max(1 - math.floor(math.log10(row["sigma"])), 0), 6)
    return f"{number(row['value'], digits)} ± {number(row['sigma'], digits)} {row['unit']}"


def heat_map(of: str, names: Sequence[str], rho: Array) -> Chart:
    """Return the chart of correlations (n, n): hue shows the sign, strength the size. Values from 0.9 are printed."""
    n, limits = len(names), (-0.5, len(names) - 0.5)
    x = Axis(limits=limits, names=names)
    chart = Chart(
        f"correlations of the unknowns of {of}", x, replace(x, down=True), title=cut(of.removeprefix("image ")),
        width=26.0 * n + 112.0, height=26.0 * n + 92.0, left=104.0, right=8.0, top=6.0, bottom=86.0, css="panel heat",
        aspect=1.0,
    )  # fmt: skip
    chart.add("cells", "cell", [], rho, tips=names)
    return chart


def singular_values(images: Sequence[dict[str, Any]]) -> Chart | None:
    """Return the chart of the singular values of each image, with the limits of weak and unobservable directions."""
    images = [image for image in images if any(v and v > 0.0 for v in image["singular_values"])][:MAX_IMAGES]
    if not images:
        return None
    high = 10.0 ** max(2, math.ceil(math.log10(max(v for o in images for v in o["singular_values"] if v))))
    axis = Axis("singular value, prior σ: weak below 1, unobservable below 1e−5", (FLOOR, high), log=True)
    names = [cut(str(image["image"]), 14) for image in images]
    rows = Axis(limits=(-0.5, len(images) - 0.5), down=True, names=names)
    chart = broad("singular values per image", axis, rows, 26.0 * len(images) + 60.0, left=120.0, top=10.0)
    for limit in (1e-5, 1.0):
        chart.upright("limit", limit)
    for k, image in enumerate(images):
        values = np.maximum([v or 0.0 for v in image["singular_values"]], FLOOR)
        chart.add("dots", f"series-{k % SERIES}", values, np.full(len(values), k))
    return chart


# --- reliability and iterations ---------------------------------------------------------------------


def redundancy_chart(values: Array, names: tuple[str, str] = LINE_SAMPLE) -> Chart | None:
    """Return the histograms of redundancy numbers (n, 2) of two coordinates."""
    if not np.isfinite(values).any():
        return None
    edges = np.linspace(0.0, 1.0, 21)
    counts = [np.histogram(np.clip(column[np.isfinite(column)], 0.0, 1.0), edges)[0] for column in values.T]
    high = 1.08 * max(1.0, float(np.max(counts)))
    chart = broad(f"redundancy numbers of {names[0]} and {names[1]}",
                  Axis("redundancy number r: 0 unchecked, 1 fully checked"),
                  Axis("coordinates of image points", (0.0, high), about=4))  # fmt: skip
    for kind, name, column in zip(("of-line", "of-sample"), names, counts, strict=True):
        chart.add("bars", kind, edges, column, label=name)
    return chart


def detectable_chart(values: Array, record: dict[str, Any]) -> Chart | None:
    """Draw the share of detected errors over their size; ``values`` (n, 2): biases of image points, nan if none."""
    known = [np.sort(column[np.isfinite(column)]) for column in values.T]
    ends = [float(end) for column in known if len(column) for end in column[[0, -1]]]
    if not ends:
        return None
    log = max(ends) > WIDE * min(ends) > 0.0
    size, power = record.get("alpha"), record.get("power")
    words = "minimal detectable bias, px" + (f" (size {size:g}, power {power:g})" if size and power else "")
    limits = (min(ends) / 1.1, max(ends) * 1.1) if log else (0.0, 1.05 * max(ends))
    chart = broad("share of detected errors", Axis(words, limits, log=log), Axis("share of image points", (0.0, 1.02)),
                  legend="right")  # fmt: skip
    for kind, name, column in zip(("of-line", "of-sample"), LINE_SAMPLE, known, strict=True):
        share = np.arange(1, len(column) + 1) / len(values)
        chart.add("line", kind, np.repeat(column, 2)[1:], np.repeat(share, 2)[:-1], label=name)
    return chart


def iteration_charts(log: Sequence[dict[str, Any]], units: str = "prior σ or m") -> list[Chart]:
    """Return charts of the weighted sum of squares and of the largest step (``units``) by iteration."""
    if not any(i["accepted"] for i in log):
        return []
    start = {"iteration": 0, "accepted": True, "after": next(i["chi2"] for i in log), "step": None}
    found = [start, *({**i, "after": i["chi2_after"]} for i in log)]
    words = {"after": "sum of weighted squares", "step": f"largest step, {units}"}
    return [chart for key, text in words.items() if (chart := _history(found, key, text)) is not None]


def _history(log: Sequence[dict[str, Any]], key: str, words: str) -> Chart | None:
    """Return the chart of one quantity by iteration; rejected steps are open squares."""
    given = [i for i in log if i[key] is not None and math.isfinite(i[key]) and i[key] > 0.0]
    if not any(i["accepted"] for i in given):
        return None
    limits = decades([i[key] for i in given])
    ends = (0.0, max(1.0, float(log[-1]["iteration"])))
    chart = Chart(f"{words} over the iterations", Axis("iteration", ends, whole=True, about=6),
                  Axis(words, limits, log=True), title=words)  # fmt: skip
    for accepted, kind in ((True, "line-dot"), (False, "sample-dot")):
        mine = [(i["iteration"], i[key]) for i in given if bool(i["accepted"]) == accepted]
        if mine:
            x, y = zip(*mine, strict=True)
            if accepted:
                chart.add("line", "curve", x, y)
            chart.add("dots", kind, x, y, label="" if accepted else "rejected")
    chart.legend = "right"
    return chart


# --- the L-curve -----------------------------------------------------------------------------------


def ranked(section: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the kappa rules by descending kappa, with their ``number`` and ``chosen``; rules that failed come last.

    Parameters
    ----------
    section : dict
        ``regularisation`` of a record.
    """
    rules = sorted(section["rules"], key=lambda rule: -math.inf if rule["kappa"] is None else rule["kappa"])[::-1]
    return [{**rule, "number": k, "chosen": rule["rule"] == section["rule"]} for k, rule in enumerate(rules, start=1)]


def l_curve(section: dict[str, Any] | None, norms: tuple[str, str] = NORMS) -> Chart | None:
    """Draw the norm of the solution over the norm of the residuals; marks are numbered as by :func:`ranked`.

    Parameters
    ----------
    section : dict or None
        ``regularisation`` of a record.
    norms : (str, str)
        Texts of both norms with their units.
    """
    if section is None:
        return None
    curve = np.array([section["curve"][name] for name in _NORMS], float).T
    curve = curve[(curve > 0.0).all(axis=1)]  # kappa = 0 of a singular system is not on the curve
    if len(curve) < 2:
        return None
    choices = [choice for choice in ranked(section) if all(choice[name] and choice[name] > 0.0 for name in _NORMS)]
    marks = np.array([[choice[name] for name in _NORMS] for choice in choices], float).reshape(-1, 2)
    limits = [limits_of(np.concatenate([curve[:, k], marks[:, k]])) for k in (0, 1)]
    chart = broad("L-curve: norm of the solution over norm of the residuals, with the choices of the rules",
                  Axis(norms[0], limits[0], log=True), Axis(norms[1], limits[1], log=True), 380.0,
                  left=62.0)  # fmt: skip
    chart.add("line", "curve", *curve.T)
    chosen = np.array([choice["chosen"] for choice in choices], bool)
    for mask, kind in ((~chosen, "sample-dot"), (chosen, "line-dot")):
        if mask.any():
            chart.add("dots", kind, *marks[mask].T)
    groups = neighbours(np.stack([chart.x.share(marks[:, 0]), chart.y.share(marks[:, 1])], axis=1), NEAR)
    if groups:
        chart.add("names", "mark-label", *np.array([marks[g].max(axis=0) for g in groups]).T,
                  tips=[", ".join(str(choices[k]["number"]) for k in group) for group in groups])  # fmt: skip
    return chart


_NORMS: Final = ("residual_norm", "solution_norm")


def neighbours(places: Array, near: float) -> list[list[int]]:
    """Group places along a curve: a place nearer than ``near`` to the previous place is in the same list."""
    out: list[list[int]] = []
    for k, place in enumerate(places):
        if out and np.linalg.norm(place - places[k - 1]) < near:
            out[-1].append(k)
        else:
            out.append([k])
    return out
