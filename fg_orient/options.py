"""Options of an adjustment: the project file's values, checked one by one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Literal, get_args

import numpy as np

from fg_orient.errors import Finding, InputError, finding

CheckPoints = Literal["use", "exclude"]
RpcCompensation = Literal["shift", "shift_drift", "affine"]
Datum = Literal["control", "priors", "inner", "free"]
RobustStart = Literal["none", "huber", "lms", "lts"]
RobustScale = Literal["prior", "mad"]
OutlierTest = Literal["baarda", "pope", "t"]
StatisticsChoice = Literal["auto", "full", "basic"]
MultipleTesting = Literal["none", "bonferroni", "sidak", "holm", "benjamini_hochberg"]

#: Bounds of options, both ends included; the project file's schema takes them from here.
EOP_SET_RANGE: Final = (1, 20)
LOOK_DEGREE_RANGE: Final = (0, 5)
CURVE_RANGE: Final = (2, 32)
ITERATION_RANGE: Final = (1, 10_000)
#: Options that are one of some words.
_WORDS: Final = {
    "rpc_compensation": get_args(RpcCompensation),
    "datum": get_args(Datum),
    "robust_start": get_args(RobustStart),
    "robust_scale": get_args(RobustScale),
    "outlier_test": get_args(OutlierTest),
    "multiple_testing": get_args(MultipleTesting),
    "statistics": get_args(StatisticsChoice),
    "check_points": get_args(CheckPoints),
}
_THREE: Final = "three numbers above zero: the sigmas of c0, c1, c2"
#: What each checked option must be, in words.
EXPECTED: Final = {
    "eop_set": f"a number from {EOP_SET_RANGE[0]} to {EOP_SET_RANGE[1]}",
    "look_polynomial": f"a degree from {LOOK_DEGREE_RANGE[0]} to {LOOK_DEGREE_RANGE[1]}; "
    "leave it out for no look-angle unknowns",
    "priors": "true or false",
    "position_sigma_m": f"{_THREE} in m",
    "velocity_sigma_m_s": f"{_THREE} in m/s",
    "attitude_sigma_rad": f"{_THREE} in rad",
    "look_sigma_rad": "a number above zero in rad",
    "look_shared": "true or false",
    "curve_intervals": f"a number from {CURVE_RANGE[0]} to {CURVE_RANGE[1]}, or 0 for no curves",
    "curve_position_sigma_m": "a number above zero in m",
    "curve_attitude_sigma_rad": "a number above zero in rad",
    "rpc_shift_sigma_px": "a number above zero in pixels",
    "rpc_linear_sigma_px": "a number above zero in pixels",
    "small_angle": "true or false",
    "image_unknowns": 'names of unknowns in brackets, each once, such as ["x_0", "roll_0"]; leave it out for a set',
    "variance_components": 'groupings in brackets, each once, such as ["image", "position", "height"]; '
    "leave it out to keep the sigmas",
    "solver": "the name of a linear solver in quotes; leave it out for the default",
    "loss": 'the name of a robust loss in quotes; "none" for least squares',
    "gnc": "true or false",
    "inlier_probability": "a number above 0 and below 1",
    "snoop": "true or false",
    "outlier_level": "a number above 0 and below 1",
    "memory_limit_gb": "a number above zero in GB (1e9 bytes); leave it out for 80 % of what is available",
    "max_iterations": f"a whole number from {ITERATION_RANGE[0]} to {ITERATION_RANGE[1]}",
    **{name: " or ".join(f'"{word}"' for word in words) for name, words in _WORDS.items()},
}


@dataclass(frozen=True)
class Options:
    """Choices of one adjustment; the project file's values, overridden by the command line.

    Parameters
    ----------
    eop_set : int
        Number 1-20 of the EOP set (docs/concepts.md).
    look_polynomial : int or None
        Degree 0-5 of the look-angle correction polynomial; None = no such unknowns.
    priors : bool
        False leaves the orientation unknowns without prior observations.
    position_sigma_m, velocity_sigma_m_s, attitude_sigma_rad : tuple of 3 floats
        Prior sigmas of c0, c1, c2 of tau.
    look_sigma_rad : float
        Prior sigma of each coefficient of the look polynomial.
    look_shared : bool
        Self-calibration: images of the same mission and instrument have one look polynomial in common. Its
        constants are the boresight (or mirror), psi_y_s1 the focal length, psi_x_s1 the turn of the line.
    curve_intervals : int
        For longer strips: beside their degree-2 coefficients, positions and attitudes of the set get smooth curves,
        cubic splines over so many equal intervals of the image (``factors.splines``); 0 = none.
    curve_position_sigma_m, curve_attitude_sigma_rad : float
        Prior standard deviation of a curve, in the mean square over the image.
    rpc_compensation : str
        Image-space compensation of RPC images: "shift", "shift_drift" or "affine".
    rpc_shift_sigma_px, rpc_linear_sigma_px : float
        Prior sigmas of the shift, and of drift and affine terms at the ends of the image (there the model's
        normalised line or sample is -1 or 1), pixels. Vendor RPC of metre-resolution images are off by some
        ten pixels of shift and by a pixel or less in the other terms.
    datum : str
        "control": control points hold the block in the world, a block without any is refused; "priors": a
        relative adjustment, the priors hold it where no control point does; "inner": a free network without priors,
        inner constraints on the ground points give its covariance; "free": nothing need hold it, the block
        stays near its start values (all steps are damped) and has no covariance.
    image_unknowns : tuple of str
        Names of the unknowns of an image, in place of ``eop_set``, ``look_polynomial`` and ``rpc_compensation``: "x_0",
        "roll_1", "psi_y_s1", "line_l1". Each image takes those that its sensor knows; the others keep the
        values of the metadata. Judged when the block is adjusted.
    small_angle : bool
        True linearises the attitude rotation in its angles, as the publications do; False keeps it exact.
    backend : str
        "auto", "graph", "schur" or "dense"; judged when the block is adjusted. "auto" takes the Schur complement
        where it can, else the graph.
    solver : str or None
        Linear solver of the dense backend by its name in the registry; None = its default, "qr". Judged
        when the block is adjusted.
    optimizer : str
        "gauss-newton", "levenberg-marquardt", "dogleg" or "native"; judged when the block is adjusted.
    loss : str
        Robust loss of image points and control points by its name in the registry (``factors.losses``); "none" is
        least squares. Judged when the block is adjusted.
    gnc : bool
        Graduated non-convexity: the loss "tls" or "geman_mcclure" is approached in stages, so that many
        gross errors do not lead into a wrong minimum. Their limits then follow from ``inlier_probability``.
    inlier_probability : float
        Probability that a good observation lies within the limit of GNC (chi-square of its dimension).
    robust_start : str
        Where a redescending loss starts from: "huber", the minimum of Huber's loss; "lms", "lts", resections of each
        image by the least median or least trimmed squares of its control points
        (``fg_orient.adjustment.resection``); "none", least squares.
    robust_scale : str
        Unit of the constant of a loss: "prior", the sigmas; "mad", times the robust scale of the residuals of image
        points and of control points (``fg_orient.adjustment.robust_scale``).
    snoop : bool
        Search for gross errors: adjust, test, leave out the worst observation, again (``fg_orient.outlier_search``).
    outlier_test : str
        Of the reports and the search: "baarda" (sigmas a priori), "pope" (tau) or "t" (scale without the suspect); see
        ``fg_orient.quality.hypotheses``.
    outlier_level : float
        Probability of a false alarm that ``multiple_testing`` controls.
    multiple_testing : str
        "none": in each test; "bonferroni", "sidak", "holm": of any among all; "benjamini_hochberg": share of false ones
        among the alarms.
    variance_components : tuple of str
        Groupings of the observations whose sigmas are estimated (``fg_orient.quality.observation_groups``); adjustment
        and estimate take turns until both stand. Judged when the block is adjusted.
    max_iterations : int
        Give up after so many, 1 to 10000.
    check_points : str
        "use": their rays take part; "exclude": left out, intersected afterwards.
    statistics : str
        "full": redundancy numbers, reliability and normalised residuals of every observation in the results of a run;
        "basic": without; "auto": full up to 200 000 image points (``fg_orient.adjustment.point_cofactors``).
    memory_limit_gb : float or None
        A run that needs more, in 1e9 bytes, is refused; None = 80 % of the available memory.

    Raises
    ------
    InputError
        One problem per value that is not possible.
    """

    eop_set: int = 15
    look_polynomial: int | None = None
    priors: bool = True
    position_sigma_m: tuple[float, float, float] = (10.0, 1.0, 0.1)
    velocity_sigma_m_s: tuple[float, float, float] = (1e-2, 1e-3, 1e-4)
    attitude_sigma_rad: tuple[float, float, float] = (50e-6, 10e-6, 2e-6)
    look_sigma_rad: float = 1e-4
    look_shared: bool = False
    curve_intervals: int = 0
    curve_position_sigma_m: float = 1.0
    curve_attitude_sigma_rad: float = 5e-6
    rpc_compensation: RpcCompensation = "shift"
    rpc_shift_sigma_px: float = 100.0
    rpc_linear_sigma_px: float = 10.0
    datum: Datum = "control"
    image_unknowns: tuple[str, ...] = ()
    small_angle: bool = False
    backend: str = "auto"
    solver: str | None = None
    optimizer: str = "gauss-newton"
    loss: str = "none"
    gnc: bool = False
    inlier_probability: float = 0.99
    robust_start: RobustStart = "huber"
    robust_scale: RobustScale = "prior"
    snoop: bool = False
    outlier_test: OutlierTest = "t"
    outlier_level: float = 0.05
    multiple_testing: MultipleTesting = "sidak"
    variance_components: tuple[str, ...] = ()
    max_iterations: int = 50
    check_points: CheckPoints = "use"
    statistics: StatisticsChoice = "auto"
    memory_limit_gb: float | None = None

    def __post_init__(self) -> None:
        problems: list[Finding] = []
        for name, expected in EXPECTED.items():
            value = getattr(self, name)
            if not _allowed(name, value):
                problems.append(finding("options.value", place=name, value=repr(value), expected=expected))
        if problems:
            raise InputError(*problems)


def _allowed(name: str, value: Any) -> bool:
    """Judge one option; what it must be stands in :data:`EXPECTED`."""
    if name in _WORDS:
        return isinstance(value, str) and value in _WORDS[name]
    match name:
        case "eop_set":
            return _whole(value, EOP_SET_RANGE)
        case "look_polynomial":
            return value is None or _whole(value, LOOK_DEGREE_RANGE)
        case "curve_intervals":
            return _whole(value, (0, 0)) or _whole(value, CURVE_RANGE)
        case "solver":
            return value is None or (isinstance(value, str) and bool(value))
        case "memory_limit_gb":
            return value is None or _positive(value)
        case "image_unknowns" | "variance_components":
            return _names(value)
        case "max_iterations":
            return _whole(value, ITERATION_RANGE)
        case "loss":
            return isinstance(value, str) and bool(value)
        case "inlier_probability" | "outlier_level":
            return _positive(value) and value < 1.0
        case "priors" | "small_angle" | "look_shared" | "gnc" | "snoop":
            return isinstance(value, bool | np.bool_)
        case "curve_position_sigma_m" | "curve_attitude_sigma_rad":
            return _positive(value)
        case "look_sigma_rad" | "rpc_shift_sigma_px" | "rpc_linear_sigma_px":
            return _positive(value)
    return isinstance(value, tuple | list) and len(value) == 3 and all(_positive(v) for v in value)


def _whole(value: Any, limits: tuple[int, int]) -> bool:
    is_whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    return bool(is_whole and limits[0] <= value <= limits[1])


def _names(value: Any) -> bool:
    is_list = isinstance(value, tuple | list) and all(isinstance(name, str) and name for name in value)
    return bool(is_list and len(set(value)) == len(value))


def _positive(value: Any) -> bool:
    is_number = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    return bool(is_number and 0.0 < value < np.inf)
