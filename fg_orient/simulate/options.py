"""Options of synthetic blocks; each field is the only declaration of its option (``fg_orient.model.options``).

The types are read at run time, so this module does not import ``annotations`` from ``__future__``.
"""

import math
from dataclasses import dataclass
from typing import Final, Literal

from fg_orient.model.declaration import Checked, Group, Names, Three, documented, option, require_allowed
from fg_orient.model.errors import InputError
from fg_orient.model.names import TABLE_FORM, TableForm

PointSet = Literal["H-0", "H-10", "H-20", "H-30", "H-40", "G-A", "G-B", "G-C"]
Errors = Literal["constant", "prior", "none"]

JitterAxis = Literal["roll", "pitch", "both"]

BLOCK: Final = Group("Block")
ORIENTATION: Final = Group("True orientation and errors")
NOISE: Final = Group("Noise")
JITTER: Final = Group("Jitter")
LEAST_CONTROL: Final = 6

# fmt: off


_SEED: Final = "Seed of all random numbers."
_IMAGE_NOISE: Final = (
    "Sigma of the noise in line and in sample. The adjustment uses the same sigma, or 0.3 px if the noise is 0."
)
_GROUND_NOISE: Final = "Sigmas East, North, Up of the noise of control and check coordinates."


@dataclass(frozen=True, kw_only=True)
class Jittered(Checked):
    """Options of the true jitter of pushbroom images, which their metadata do not contain."""

    jitter_px: float = option(
        0.0, JITTER, "Amplitude of a sine wave of the attitude. One pixel is the angle of one detector element.",
        within=(0.0, 10.0), unit="px", zero="no jitter",
    )
    jitter_cycles: float = option(4.0, JITTER, "Cycles of the wave from the first to the last line.", below=100.0)
    jitter_axis: JitterAxis = option("both", JITTER, "Angles that have jitter: roll, pitch, or both.")
    jitter_phase_deg: float | None = option(
        None, JITTER, "Phase of the wave at the first line.", within=(-360.0, 360.0), unit="deg",
        left_out="a random phase for each image and angle",
    )
    jitter_images: Names = option(
        (), JITTER, "Ids of the images that have jitter.", such=("left",), left_out="all pushbroom images",
    )


@documented
@dataclass(frozen=True)
class ZonguldakOptions(Jittered):
    """Options of the synthetic Zonguldak pair.

    Points, roles, errors of the metadata, image noise and ground noise come from independent streams of the seed.
    """

    seed: int = option(1, NOISE, _SEED, within=(0, math.inf))
    point_set: PointSet = option("H-10", BLOCK, "Set of check points of the published experiments.")
    image_noise_px: float = option(0.3, NOISE, _IMAGE_NOISE, within=(0.0, 30.0), unit="px")
    errors: Errors = option(
        "constant", ORIENTATION, "Errors of the metadata's orientation. constant: 5 m per ECEF axis, 20 microrad per "
        "angle, random signs per image; prior: all 27 coefficients are random with the prior sigmas.",
    )
    distortion_rad: float = option(
        0.0, ORIENTATION,
        "True look angles: look angles of the file plus this value times s^2. s is -1 at the first sample, +1 at the "
        "last.",
        within=(-1e-4, 1e-4), unit="rad",
    )
    radial_velocity_m_s: float = option(
        0.0, ORIENTATION, "Rate of the distance from the geocentre. Real SPOT 5: 7 to 9 m/s.", within=(-100.0, 100.0),
        unit="m/s",
    )
    attitude_rad: Three = option(
        (0.0, 0.0, 0.0), ORIENTATION, "True roll, pitch and yaw of both images, such as "
        "-1.6e-4,-7.2e-4,9e-4 (after an equals sign where the first is negative).", within=(-1e-2, 1e-2), unit="rad",
    )
    ground_noise_m: Three = option((0.06, 0.06, 1.0), NOISE, _GROUND_NOISE, within=(0.0, 100.0), unit="m")


@documented
@dataclass(frozen=True)
class BlockOptions(Jittered):
    """Options of a synthetic block of ``rows * columns`` images, at least 2."""

    rows: int = option(2, BLOCK, "Rows of scenes.", within=(1, 20))
    columns: int = option(2, BLOCK, "Columns of scenes.", within=(1, 20))
    points: int = option(400, BLOCK, "Ground points, each in two or more images.", within=(LEAST_CONTROL, 10_000_000))
    seed: int = option(1, NOISE, _SEED, within=(0, math.inf))
    spacing_m: float = option(28e3, BLOCK, "Distance of neighbouring scenes.", within=(1e3, 40e3), unit="m")
    roll_deg: float = option(
        12.0, BLOCK, "Mirror angle; strips look alternately to both sides.", within=(1.0, 27.0), unit="deg",
    )
    control_share: float = option(0.02, BLOCK, "Share of control points (at least 6 points).", within=(0.0, 1.0))
    check_share: float = option(0.1, BLOCK, "Share of check points; the rest are tie points.", within=(0.0, 1.0))
    image_noise_px: float = option(0.3, NOISE, _IMAGE_NOISE, within=(0.0, 30.0), unit="px")
    errors: Errors = option("prior", ORIENTATION, "Errors of the metadata's orientation, see `ZonguldakOptions`.")
    ground_noise_m: Three = option((0.5, 0.5, 0.5), NOISE, _GROUND_NOISE, within=(0.0, 100.0), unit="m")
    tables: TableForm = option(
        TABLE_FORM, BLOCK, "Form of the tables. parquet and arrow need pyarrow (extra `arrow`) and suit large blocks."
    )
    max_height_m: float = option(
        500.0, BLOCK, "Largest height; heights are uniformly distributed from 0 to it.", within=(0.0, 8000.0), unit="m",
    )

    def __post_init__(self) -> None:
        require_allowed(self)
        require(self.rows * self.columns >= 2, "rows, columns", (self.rows, self.columns), "two images or more")
        shares = (self.control_share, self.check_share)
        require(sum(shares) <= 1.0, "control_share, check_share", shares, "shares with a sum of at most 1")


@documented
@dataclass(frozen=True)
class MixedOptions:
    """Options of a mixed block."""

    points: int = option(90, BLOCK, "Total number of ground points.", within=(10, 100_000))
    control: int = option(8, BLOCK, "Control points.", within=(3, 100_000))
    check: int = option(12, BLOCK, "Check points; the rest are tie points.", within=(0, 100_000))
    seed: int = option(1, NOISE, _SEED, within=(0, math.inf))
    spot_noise_px: float = option(0.4, NOISE, "Sigma of the noise of the SPOT-5 images.", within=(0.0, 10.0), unit="px")
    rpc_noise_px: float = option(0.3, NOISE, "Sigma of the noise of the RPC images.", within=(0.0, 10.0), unit="px")
    frame_noise_px: float = option(0.5, NOISE, "Sigma of the noise of the frame images.", within=(0.0, 10.0), unit="px")
    errors: Literal["prior", "none"] = option(
        "prior", ORIENTATION, "Errors of the orientation: random with the prior sigmas, or none.",
    )
    ground_noise_m: Three = option((0.05, 0.05, 0.08), NOISE, _GROUND_NOISE, within=(0.0, 100.0), unit="m")

    def __post_init__(self) -> None:
        require_allowed(self)
        named = self.control + self.check
        require(named <= self.points, "control, check", named, f"at most {self.points} points")


def require(holds: bool, option: str, value: object, expected: str) -> None:
    """Raise InputError for the value of an option unless a condition is true.

    Raises
    ------
    InputError
        ``holds`` is false.
    """
    if not holds:
        raise InputError.of("options.value", option=option, value=value, expected=expected)
