"""Options of an adjustment and of reading a project; each option is declared only by its field.

Annotations are not postponed, because the types are read at run time.
"""

from dataclasses import dataclass
from typing import Final, Literal

from fg_orient.model.declaration import Checked, Group, Names, Three, documented, option
from fg_orient.model.names import ALL_SETS, EOP_SETS, TABLE_FORM, TableForm

CheckPoints = Literal["use", "exclude"]
RpcCompensation = Literal["shift", "shift_drift", "affine"]
Datum = Literal["auto", "control", "vendor", "priors", "inner", "free"]
Backend = Literal["auto", "graph", "schur", "dense"]
Optimizer = Literal["gauss-newton", "levenberg-marquardt", "dogleg"]
RobustStart = Literal["none", "huber", "lms", "lts"]
RobustScale = Literal["prior", "mad", "quantile"]
SnoopKind = Literal["groups", "points"]
OutlierTest = Literal["baarda", "pope", "t"]
StatisticsChoice = Literal["auto", "full", "basic"]
Regularisation = Literal["none", "tikhonov", "truncated", "minimum_norm", "generalised_ridge", "stein", "ridge_stein"]
PenaltyKind = Literal["deviation", "gradient", "laplace"]
RegularisedUnits = Literal["prior_sigmas", "raw", "columns"]
Jitter = Literal["none", "auto"]
MultipleTesting = Literal["none", "bonferroni", "sidak", "holm", "benjamini_hochberg"]

#: Longest extrapolation of attitudes, s: a rate error of 1e-6 rad/s gives an error of 5 m on the ground.
MAX_EXTRAPOLATION_S: Final = 5.0
#: Groups of observations whose standard deviations are estimated if no others are named.
USUAL_GROUPS: Final = ("image", "position", "height")

UNKNOWNS: Final = Group("Unknowns of the images", "orientation", "concepts.md")
PRIORS: Final = Group("Prior standard deviations", "orientation")
ADJUSTMENT: Final = Group("Adjustment", "adjustment")
REGULARISATION: Final = Group("Regularisation", "adjustment", "regularisation.md")
ROBUST: Final = Group("Robust adjustment", "adjustment", "robust.md")
TESTS: Final = Group("Gross errors and statistics", "adjustment", "outliers.md")
RESULTS: Final = Group("Result folder", "adjustment", "results.md")


@documented
@dataclass(frozen=True)
class Options(Checked):
    """Options of one adjustment: values of the project file, unless the command line replaces them."""

    # fmt: off
    eop_set: int = option(
        15, UNKNOWNS, f"EOP set, {ALL_SETS} or a name such as PUA.", within=(1, len(EOP_SETS)), such="PUA",
        recorded=True,
    )
    look_polynomial: int | None = option(
        None, UNKNOWNS, "Degree of the look-angle correction polynomial.",
        within=(0, 5), left_out="no look-angle unknowns", recorded=True,
    )
    priors: bool = option(
        True, UNKNOWNS,
        "Observe the orientation unknowns. Their prior standard deviations are the options named sigma.",
        recorded=True,
    )
    position_sigma_m: Three = option(
        (10.0, 1.0, 0.1), PRIORS, "Prior sigmas of the position: constant, linear, quadratic coefficient.", unit="m",
        component="prior position",
    )
    velocity_sigma_m_s: Three = option(
        (1e-2, 1e-3, 1e-4), PRIORS, "Prior sigmas of the velocity.", unit="m/s", component="prior velocity"
    )
    attitude_sigma_rad: Three = option(
        (50e-6, 10e-6, 2e-6), PRIORS, "Prior sigmas of roll, pitch and yaw.", unit="rad", component="prior attitude",
    )
    look_sigma_rad: float = option(
        1e-4, PRIORS, "Prior sigma of each look-angle coefficient.", unit="rad", component="prior look angles"
    )
    look_shared: bool = option(
        False, UNKNOWNS,
        "Self-calibration: one look-angle correction for all images of the same mission and instrument. Its constants "
        "are the boresight (or mirror), psi_y_s1 is the focal length, psi_x_s1 the rotation of the line.",
    )
    curve_intervals: int = option(
        0, UNKNOWNS,
        "Intervals of smooth curves of position and attitude. Longer strips need them in addition to the quadratic "
        "polynomials; the curves are cubic splines over equal intervals of the image (`factors.geometry.polynomials`).",
        within=(2, 32), zero="no curves",
    )
    curve_position_sigma_m: float = option(
        1.0, PRIORS, "Prior sigma of a position curve, root mean square over the image.", unit="m"
    )
    curve_attitude_sigma_rad: float = option(
        5e-6, PRIORS, "Prior sigma of an attitude curve, root mean square over the image.", unit="rad"
    )
    jitter: Jitter = option(
        "none", UNKNOWNS,
        "Jitter of the attitude of pushbroom images. auto: test roll and pitch of each image, choose resolution and "
        "strength of their curves by restricted likelihood, and adjust with these curves. It replaces `jitter_curves`.",
    )
    jitter_curves: Names = option(
        (), UNKNOWNS,
        "Jitter curves of single images: image, angle (roll or pitch), number of intervals (2 to 32) and prior sigma "
        "in rad, separated by colons. The coefficients of a curve are independent (`factors.geometry.polynomials`).",
        such="left:roll:16:3e-6", left_out="no jitter",
    )
    rpc_compensation: RpcCompensation = option(
        "shift", UNKNOWNS,
        "Unknowns of an RPC image. shift: a shift in line and sample; shift_drift: also terms linear in line; affine: "
        "also terms linear in sample.",
        recorded=True,
    )
    rpc_shift_sigma_px: float = option(
        100.0, PRIORS,
        "Prior sigma of the shift of an RPC image. Vendor RPC of images with metre resolution have errors of some ten "
        "pixels.",
        unit="px", component="prior RPC shift",
    )
    rpc_linear_sigma_px: float = option(
        10.0, PRIORS,
        "Prior sigma of the other terms of an RPC image, at the ends of the image. There the normalised line or sample "
        "is -1 or 1.",
        unit="px", component="prior RPC linear",
    )
    image_unknowns: Names = option(
        (), UNKNOWNS,
        "Names of single unknowns of an image instead of a set. They replace `eop_set`, `look_polynomial` and "
        "`rpc_compensation`. Each image uses the names that its sensor has, such as psi_y_s1 or line_l1. The other "
        "unknowns keep the values of the metadata.",
        such=("x_0", "roll_0"), left_out="the EOP set",
    )
    small_angle: bool = option(
        False, UNKNOWNS, "Small-angle attitude matrix of the published procedure. False: the exact rotation."
    )
    backend: Backend = option(
        "auto", ADJUSTMENT,
        "Least-squares engine: GTSAM's optimisers on a factor graph (graph), our own loop on arrays (schur), or full "
        "matrices for up to 2000 unknowns (dense). auto chooses graph. It chooses schur for a free datum, and for many "
        "images if schur solves the reduced system in a third of the time.",
    )
    solver: str | None = option(
        None, ADJUSTMENT,
        "Linear solver of the dense backend, such as qr or cramer_inverse. See fg_orient.adjustment.linear.registry.",
        such="qr", left_out="qr",
    )
    optimizer: Optimizer = option(
        "gauss-newton", ADJUSTMENT,
        "Optimiser. The graph backend uses GTSAM's optimiser, the other backends use ours.",
        recorded=True,
    )
    regularisation: Regularisation = option(
        "none", REGULARISATION,
        "Treatment of image unknowns that the observations determine badly, on all backends. tikhonov: kappa times the "
        "squared penalty is added; truncated: directions with a squared singular value below kappa stay at the "
        "metadata; minimum_norm: directions below `rank_cut` stay there. generalised_ridge, stein, ridge_stein: "
        "shrinkage of each or of all directions by the size of their estimates.",
        recorded=True,
    )
    kappa: float | None = option(
        None, REGULARISATION,
        "Regularisation parameter: weight of the squared penalty, with one prior sigma as unit.",
        within=(1e-100, 1e100),
        left_out="the parameter of `kappa_rule`",
    )
    kappa_rule: str = option(
        "bayes", REGULARISATION,
        "Rule for kappa at the start values, which is then held. bayes: 1, one prior sigma; others are l_curve, gcv, "
        "discrepancy, quasi_optimality, hkb, lw, maximum, od, creso and zero_crossing.",
        such="gcv",
    )
    penalty: PenaltyKind = option(
        "deviation", REGULARISATION,
        "Penalty L x of Tikhonov's method. deviation: all image unknowns, in `regularised_units`; gradient, laplace: "
        "first or second derivative of each correction function of an image at equal times, in prior sigmas.",
    )
    penalty_deviation: bool = option(
        False, REGULARISATION,
        "Add the deviation of all unknowns to another penalty, which may leave some of them undetermined.",
    )
    rank_cut: float = option(
        1e-9, REGULARISATION,
        "Singular values up to this share of the largest are not counted in the rank. Without a gap of 100 around the "
        "cut the rank is ambiguous, which the result reports as a doubt.",
        within=(1e-100, 0.9),
    )
    regularised_units: RegularisedUnits = option(
        "prior_sigmas", REGULARISATION,
        "Units of the norm of the deviation and of the singular values. prior_sigmas: prior standard deviations, used "
        "as units only; raw: m, m/s, rad, px; columns: columns of the reduced Jacobian have length 1.",
    )
    loss: str = option(
        "none", ROBUST,
        "Robust loss, such as huber, hampel, tukey or tls; none: least squares. The loss applies to image points and "
"control points. Other losses are andrews, danish, cauchy, geman_mcclure, welsch, danish_original and lad "
        "(`factors.losses`).",
        such="huber", recorded=True,
    )
    gnc: bool = option(
        False, ROBUST,
        "Graduated non-convexity: start from least squares and approach the loss tls or geman_mcclure in stages. This "
        "avoids wrong minima with many gross errors. The limit of the loss follows from `inlier_probability`.",
        recorded=True,
    )
    inlier_probability: float = option(
        0.99, ROBUST,
        "Probability that a good observation lies within the limit of GNC. The limit is a quantile of the chi-square "
        "distribution with the dimension of the observation.",
        below=1.0,
    )
    robust_start: RobustStart = option(
        "huber", ROBUST,
        "Start of a redescending loss. lms, lts: resections by control points that minimise the median or the trimmed "
        "sum of squares of each image; huber: minimum of Huber's loss; none: least squares.",
        recorded=True,
    )
    robust_scale: RobustScale = option(
        "prior", ROBUST,
        "Unit of a loss. prior: the given standard deviations; mad: the given standard deviations times robust scales "
        "of the residuals of image points and of control points; quantile: the constant of the loss is a quantile of "
        "the residuals of the image points, as in ISIS jigsaw (`loss_quantile`).",
        recorded=True,
    )
    loss_quantile: float = option(
        0.5, ROBUST,
        "Share of the residuals of the image points below the constant of the loss, with `robust_scale` quantile.",
        below=1.0,
    )
    snoop: bool = option(
        False, TESTS,
        "Search for gross errors: adjust, leave out the worst observation, adjust again. "
        "See fg_orient.orientation.outlier_search.",
        iterates=False,
    )
    snoop_kind: SnoopKind = option(
        "groups", TESTS,
        "Observations that the search leaves out together. groups: an image point or the coordinates of a control "
        "point; points: all observations of a point.",
        iterates=False,
    )
    median_rejection: float | None = option(
        None, TESTS,
        "Reject image points by the rule of ISIS jigsaw before the adjustment: the limit is the median of the "
        "residuals plus this multiple of 1.4826 times their median absolute deviation. Jigsaw's default is 3. The rule "
        "has no level of significance (`fg_orient.orientation.median_rejection`).",
        such="3.0", left_out="no rejection by the median", iterates=False,
    )
    outlier_test: OutlierTest = option(
        "t", TESTS,
        "Test of single observations. baarda: test with a priori standard deviations; pope: tau test; t: test with a "
        "scale estimated without the tested observation. Reports use the same test.",
        iterates=False,
    )
    outlier_level: float = option(
        0.05, TESTS, "Probability of at least one false alarm (see `multiple_testing`).", below=1.0, iterates=False
    )
    multiple_testing: MultipleTesting = option(
        "sidak", TESTS,
        "Quantity that `outlier_level` limits. none: the probability of a false alarm of each test; bonferroni, sidak, "
        "holm: the probability of at least one false alarm; benjamini_hochberg: the share of false alarms among the "
        "alarms.",
        iterates=False,
    )
    accept: Names = option(
        (), TESTS,
        "Known doubts that do not change the status. Write each as CODE, CODE:OBJECT or CODE:OBJECT<=LIMIT, as in the "
        "remedy of the doubt; LIMIT is the largest accepted size.",
        such=("gross_error:point 12",), left_out="none", iterates=False,
    )
    required_accuracy_m: float | None = option(
        None, TESTS,
        "Required standard deviation of every adjusted point along each axis. A point above it makes the result "
        "not trustworthy.",
        unit="m", left_out="no requirement", iterates=False,
    )
    variance_components: Names = option(
        (), TESTS,
        "Estimate the standard deviations of groups of observations. The usual groups are the image points, the "
        "positions and the heights; others are in fg_orient.quality.observation_groups. Adjustment and estimation "
        "alternate until both have converged.",
        usual=USUAL_GROUPS, left_out="the given standard deviations", iterates=False,
    )
    max_iterations: int = option(50, ADJUSTMENT, "Maximum number of iterations.", within=(1, 10_000), iterates=False)
    check_points: CheckPoints = option(
        "use", ADJUSTMENT,
        "Use the image points of check points, or exclude them. Excluded check points are intersected afterwards.",
        recorded=True,
    )
    datum: Datum = option(
        "auto", ADJUSTMENT,
        "Datum of the block. control: the control points define it, the block must have some. The other datums are "
        "relative. vendor: directions of the images that the rays hardly determine stay as in the metadata; auto: "
        "vendor for satellite images with priors and without control point, else control; priors: the priors define "
        "directions that control points do not determine; inner: free network without priors, inner constraints on "
        "the ground points define its covariance; free: all steps are damped, and there is no covariance.",
        recorded=True,
    )
    statistics: StatisticsChoice = option(
        "auto", TESTS,
        "Statistics of every observation. full: the results contain redundancy numbers, reliability and normalised "
        "residuals; basic: they do not; auto: full for up to 2 000 000 image points.",
        iterates=False,
    )
    tables: TableForm = option(
        TABLE_FORM, RESULTS,
        "Form of the tables of the result folder. parquet and arrow need pyarrow (extra `arrow`): they keep the types "
        "of the columns, are smaller, and are read faster.",
        iterates=False,
    )
    memory_limit_gb: float | None = option(
        None, ADJUSTMENT,
        "Memory limit of a run. The memory is estimated before the run; larger blocks are in parts or refused.",
        unit="GB", spelled="memory-limit-gb", left_out="80 % of the available memory", iterates=False,
    )
    # fmt: on

    @property
    def holds_unknowns(self) -> bool:
        """True if priors or a regularisation determine the directions that the observations do not determine."""
        return self.priors or self.regularisation != "none"


@documented
@dataclass(frozen=True)
class Reading(Checked):
    """Options for reading a project file; the block does not store them."""

    # fmt: off
    extrapolate_attitude_s: float = option(
        0.0, UNKNOWNS,
        "Extrapolate attitudes with the last rate by at most this time. Lines without attitudes are refused.",
        within=(0.0, MAX_EXTRAPOLATION_S), unit="s",
    )
    light: Names = option(
        (), UNKNOWNS,
        "Effects on light in images whose format leaves the choice (DigitalGlobe, CSM, lattice): aberration, "
        "light_time, refraction, or none.",
        such=("aberration", "refraction"), left_out="the usual effects of the format",
    )
    points_seen_once: Literal["error", "drop"] = option(
        "error", ADJUSTMENT, "Refuse check and tie points with a single image point, or drop them."
    )
    # fmt: on
