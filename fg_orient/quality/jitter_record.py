"""Write the evidence for jitter in words and as a table: verdict, amplitude and band of each angle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from factors.arrays import Array
from fg_orient.model.block import Block
from fg_orient.model.distributions import INSIDE_95
from fg_orient.model.errors import Finding, finding
from fg_orient.model.jitter import JitterCurve
from fg_orient.quality.jitter import LEVEL, PER_CYCLE, Band, JitterChoice

Verdict = Literal["found", "not found", "cannot be told"]
#: Columns of the table ``jitter``.
COLUMNS: Final = (
    "image", "component", "line", "value_px", "sd_px", "lower_px", "upper_px", "value_rad", "sd_rad", "lower_rad",
    "upper_rad",
)  # fmt: skip


@dataclass(frozen=True)
class AngleJitter:
    """Evidence for jitter of one angle of one image.

    Parameters
    ----------
    image, angle : str
    verdict : str
        Verdict; "cannot be told" means that the points resolve no frequency of this angle.
    px_per_rad : float
        Motion of image points per rad, root mean square.
    curve : JitterCurve or None
        Chosen resolution and strength, if jitter was found.
    band : Band or None
    line : (N,) array
        Lines of the band.
    bound_px : float
        Upper confidence bound (95 %) of the amplitude, where no jitter was found; nan if the points
        cannot show jitter.
    resolved_cycles : float
        Highest frequency, in cycles per image, that the points resolve.
    absorbed_by_points, absorbed_by_orientation : float
        Shares of the effect of jitter on image points that ground points and other
        unknowns of the images absorb.
    """

    image: str
    angle: str
    verdict: Verdict
    px_per_rad: float
    curve: JitterCurve | None
    band: Band | None
    line: Array
    bound_px: float
    resolved_cycles: float
    absorbed_by_points: float
    absorbed_by_orientation: float

    @property
    def amplitude_px(self) -> float:
        """Amplitude of a sine wave with the estimated mean square; nan if no jitter was found."""
        return float("nan") if self.band is None else self.band.amplitude_px

    @property
    def sentence(self) -> str:
        """Verdict in words."""
        of = f"{self.angle} of {self.image}"
        reach = f"the points resolve up to {self.resolved_cycles:.1f} cycles per image"
        absorbed = f"ground points absorb {100.0 * self.absorbed_by_points:.0f} % of its effect"
        if self.curve is not None:
            urad = 1e6 * self.amplitude_px / self.px_per_rad
            text = f"{of}: jitter with an amplitude of {self.amplitude_px:.2f} px ({urad:.2f} microrad)"
            beyond = self.curve.intervals / PER_CYCLE > self.resolved_cycles
            return f"{text}; {reach}, so that the band is wide between the points" if beyond else f"{text}; {reach}"
        if self.verdict == "not found":
            return f"{of}: no jitter found; an amplitude above {self.bound_px:.2f} px is excluded; {reach}"
        return f"{of}: jitter cannot be told, because too few points determine it; {absorbed}"

    def as_dict(self) -> dict[str, Any]:
        """Return the entry of ``result.json``."""
        curve = self.curve
        return {
            "image": self.image,
            "angle": self.angle,
            "verdict": self.verdict,
            "intervals": None if curve is None else curve.intervals,
            "prior_sigma_rad": None if curve is None else curve.sigma_rad,
            "amplitude_px": self.amplitude_px,
            "amplitude_rad": self.amplitude_px / self.px_per_rad,
            "amplitude_bound_px": self.bound_px,
            "px_per_rad": self.px_per_rad,
            "resolved_cycles": self.resolved_cycles,
            "absorbed_by_points": self.absorbed_by_points,
            "absorbed_by_orientation": self.absorbed_by_orientation,
            "sentence": self.sentence,
        }

    def rows(self) -> list[tuple[object, ...]]:
        """Return the rows of the table ``jitter``."""
        if self.band is None:
            return []
        value, half = self.band.value, INSIDE_95 * self.band.sd
        px = np.stack([value, self.band.sd, value - half, value + half], axis=1)
        both = np.hstack([self.line[:, None], px, px / self.px_per_rad])
        return [(self.image, self.angle, *row) for row in both.tolist()]


@dataclass(frozen=True)
class Jitter:
    """Evidence for jitter of a block.

    Parameters
    ----------
    angles : tuple of AngleJitter
    steps : tuple of dict
        Test of each step: image, angle, gain of log likelihood, its limit, and probability without jitter.
    """

    angles: tuple[AngleJitter, ...]
    steps: tuple[dict[str, Any], ...]

    @property
    def curves(self) -> tuple[JitterCurve, ...]:
        """Curves of the angles with jitter."""
        return tuple(angle.curve for angle in self.angles if angle.curve is not None)

    def as_dict(self) -> dict[str, Any]:
        """Return the entry ``jitter`` of ``result.json``."""
        return {"level": LEVEL, "steps": list(self.steps), "angles": [angle.as_dict() for angle in self.angles]}

    def rows(self) -> list[tuple[object, ...]]:
        """Return the rows of the table ``jitter``."""
        return [row for angle in self.angles for row in angle.rows()]

    def findings(self) -> tuple[Finding, ...]:
        """Return one note per verdict."""
        by_verdict: dict[str, list[AngleJitter]] = {}
        for angle in self.angles:
            by_verdict.setdefault(angle.verdict, []).append(angle)
        codes = {"found": "jitter.found", "not found": "jitter.not_found", "cannot be told": "jitter.untold"}
        return tuple(
            finding(codes[verdict], angles=_named(own, with_amplitude=verdict == "found"))
            for verdict, own in by_verdict.items()
        )


def _named(angles: Sequence[AngleJitter], *, with_amplitude: bool) -> list[str]:
    return [f"{a.angle} of {a.image}" + (f" ({a.amplitude_px:.2f} px)" if with_amplitude else "") for a in angles]


def jitter_of(choice: JitterChoice, block: Block) -> Jitter:
    """Return the record of a choice for the images of a block."""
    system = choice.system
    bounds = choice.steps[-1].bounds if choice.steps else np.full(len(system.angles), np.nan)
    number = {chosen.angle: k for k, chosen in enumerate(choice.chosen)}
    out = []
    for k, angle in enumerate(system.angles):
        image, cycles, band, curve = block.images[angle.image], choice.resolved_cycles(k), None, None
        verdict: Verdict = "not found" if cycles > 0.0 else "cannot be told"
        if k in number:
            own = choice.chosen[number[k]]
            curve = JitterCurve(image.id, angle.name, own.intervals, own.px / angle.px_per_rad)
            band, verdict = choice.band(number[k]), "found"
        line = np.zeros(0) if band is None else 0.5 * (band.tau + 1.0) * (image.sensor.n_lines - 1)
        bound = float("nan") if band is not None else float(bounds[k])
        out.append(
            AngleJitter(
                image.id, angle.name, verdict, angle.px_per_rad, curve, band, line, bound, cycles, *choice.absorbed(k)
            )
        )
    steps = tuple(
        {
            "image": block.images[system.angles[one.best.angle].image].id,
            "angle": system.angles[one.best.angle].name,
            "gain": one.gain,
            "limit": one.limit,
            "p": one.p,
        }
        for one in choice.steps
    )
    return Jitter(tuple(out), steps)
