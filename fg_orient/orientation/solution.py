"""Result of an adjustment: state, fit, observability, accuracy; covariance and tests are computed at first use.

Cofactors are in prior scale (sigma0 = 1 a priori), as tests of predictions require. :meth:`Solution.covariance`
multiplies them by the a posteriori variance factor ``sigma0^2``, as reports require.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.loop import IterationRecord
from fg_orient.adjustment.memory import Need
from fg_orient.adjustment.reduced_choice import Choice
from fg_orient.model.errors import Finding, InputError, NoSolutionError
from fg_orient.model.options import USUAL_GROUPS
from fg_orient.orientation.adjusted import AdjustmentResult
from fg_orient.quality.accuracy import Accuracy
from fg_orient.quality.cause import Supposed
from fg_orient.quality.covariance import NamedMatrix, joint_cofactors
from fg_orient.quality.figures import AdjustedFigure, adjusted_figures
from fg_orient.quality.hypotheses import GlobalTest, global_test
from fg_orient.quality.observability import BlockObservability, ImageObservability
from fg_orient.quality.outlier_records import GroupTest
from fg_orient.quality.rejection import Search
from fg_orient.quality.reliability import ALPHA, POWER, BlockReliability, reliability
from fg_orient.quality.significance import LEVEL as SIGNIFICANCE_LEVEL
from fg_orient.quality.significance import Significance, significance
from fg_orient.quality.stated_sigmas import StatedSigma
from fg_orient.quality.suspects import Kind
from fg_orient.quality.variance_components import Method, UnknownFreedom, VarianceComponents, variance_components
from fg_orient.result.record import Result, html_table, one_line, overview

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pandas

    from fg_orient.quality.accuracy import PredictionTest
    from fg_orient.quality.dem_accuracy import DemComparison
    from fg_orient.quality.free_network import FreeNetwork
    from fg_orient.quality.jitter_record import Jitter
    from fg_orient.quality.located_point import LocatedPoint, Orientation
    from fg_orient.sensors.correction import HeightSurface


@dataclass(frozen=True)
class Seconds:
    """Wall-clock seconds of each phase; the command line sets ``read``."""

    read: float = 0.0
    structure: float = 0.0
    jit: float = 0.0
    solve: float = 0.0
    statistics: float = 0.0

    @property
    def total(self) -> float:
        """Sum of all phases."""
        return self.read + self.structure + self.jit + self.solve + self.statistics


@dataclass(frozen=True, kw_only=True, repr=False)
class Solution(AdjustmentResult):
    """Result of :func:`fg_orient.adjust`; further attributes: :class:`AdjustmentResult`.

    Parameters
    ----------
    verdict : Finding
        Reason of the status; ``reason`` is its sentence.
    end : Finding
        Reason for the end of the iteration; ``ended`` is its sentence.
    ground_m : (N, 3) array
        Adjusted ECEF coordinates in file order. Excluded check points are intersected; points without image points are
        nan.
    residuals_px : (n, 2) array
        Line and sample residuals, adjusted minus observed, of ``problem.observations``.
    sigma0_interval : (float, float)
        99.9 % interval of sigma0 if model and weights are right; nan under a loss and with variance components.
    observability : tuple of ImageObservability
    block_view : BlockObservability or None
        Observability of the whole block without priors; only if there are no priors or they fix the datum.
    accuracy : Accuracy
        Differences at control and check points.
    backend, solver : str
        Backend, and linear solver of the dense backend ("" otherwise).
    memory : Need or None
        Estimated memory of the run, and its limit.
    resumed_at : int
        Iterations of an interrupted run that this run continued.
    snooping : Search or None
        Search for gross errors, if the options request one.
    rejected : tuple of str
        Image points, as ``12 in left``, that the option ``median_rejection`` left out.
    sigmas : tuple of StatedSigma
        Stated sigmas of groups of observations, with the estimated sigmas if the observations are tested.
    supposed : Supposed or None
        Most likely mistake, until a further adjustment has decided on it.
    jitter : Jitter or None
        Evidence for jitter, if the option ``jitter`` requests it.
    reduced_system : Choice or None
        Method of the Schur backend for the reduced system of the images, with predicted operations and bytes.
    """

    verdict: Finding
    end: Finding
    backend: str
    solver: str
    optimizer: str
    ground_m: Array
    sigma0_interval: tuple[float, float]
    log: tuple[IterationRecord, ...]
    iterations: int
    residuals_px: Array
    observability: tuple[ImageObservability, ...]
    accuracy: Accuracy
    findings: tuple[Finding, ...] = ()
    block_view: BlockObservability | None = None
    memory: Need | None = None
    seconds: Seconds = field(default_factory=Seconds)
    resumed_at: int = 0
    snooping: Search | None = None
    rejected: tuple[str, ...] = ()
    sigmas: tuple[StatedSigma, ...] = ()
    supposed: Supposed | None = None
    jitter: Jitter | None = None
    reduced_system: Choice | None = None

    @property
    def scale(self) -> float:
        """Factor that converts roots of cofactors to standard deviations: sigma0, or 1 (prior scale) under a loss."""
        return self.sigma0 if self.weights is None else 1.0

    @property
    def reason(self) -> str:
        """Sentence of the verdict."""
        return str(self.verdict)

    @property
    def ended(self) -> str:
        """Sentence on the end of the iteration."""
        return str(self.end)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences of the findings."""
        return tuple(map(str, self.findings))

    @property
    def rank_defect(self) -> dict[str, int]:
        """Number of unobservable directions per image."""
        return {o.image: o.rank_defect for o in self.observability}

    @property
    def unobservable(self) -> tuple[str, ...]:
        """One sentence per unobservable direction, free motion of the block, and navigation datum fixed by priors."""
        datum = () if self.block_view is None else (*self.block_view.datum, *self.block_view.on_board)
        return (*(sentence for o in self.observability for sentence in o.sentences), *datum)

    def correction(self, image: str) -> Any:
        """Return the correction of an image in physical units, for ``project``, ``locate`` and ``rays`` of its sensor.

        ``Correction`` of a pushbroom image, compensation (6,) in pixels of an RPC image (``factors.cameras.rfm``).
        Raise InputError if the image is unknown.
        """
        if image not in [i.id for i in self.block.images]:
            raise InputError.of("covariance.no_such", place="correction", value=image)
        return self.problem.corrections(self.state)[self.block.image_index(image)]

    def cofactor_matrix(self, *names: str) -> NamedMatrix:
        """Return the joint cofactor matrix (prior scale) of adjusted quantities, by name.

        "image:left" (all its parameters), "image:left.x_0" (one), "point:12", "point:12.z", "observation:left/12"
        (adjusted line and sample of an image point), "residual:left/12". Units are physical: m, m/s, rad for
        images, ECEF metres for points, pixels; see ``fg_orient.quality.covariance``. InputError for a name that does
        not exist, or a point that is not an unknown.
        """
        return joint_cofactors(self.weighted, self.state, self.required_cofactors(), names)

    def covariance(self, *names: str) -> NamedMatrix:
        """Return the joint covariance ``scale^2 Q`` of adjusted quantities; see :meth:`cofactor_matrix`."""
        q = self.cofactor_matrix(*names)
        return NamedMatrix(q.names, q.units, q.values * self.scale**2)

    def figures(self) -> tuple[AdjustedFigure, ...]:
        """Return planes, lines, circles, spheres and spheroids of the constraints; NoSolutionError: no covariance."""
        return adjusted_figures(self.problem, self.state, self.required_cofactors(), self.scale)

    @cached_property
    def unknown_freedom(self) -> UnknownFreedom | None:
        """Degrees of freedom of tests of unknowns with estimated variance components; None without components."""
        return None if self.components is None else UnknownFreedom.of(self.residual_cofactors, self.components)

    def locate(
        self,
        image: str,
        line: float,
        sample: float,
        *,
        height_m: float | None = None,
        dem: HeightSurface | None = None,
        height_sigma_m: float = 0.0,
        sigma_px: tuple[float, float] | None = None,
    ) -> LocatedPoint:
        """Locate a pixel with the adjusted orientation, with covariance, error ellipse, CE90, LE90 and SE90.

        Parameters
        ----------
        image : str
        line, sample : float
            (0, 0) = centre of the first pixel.
        height_m : float, optional
            Ellipsoidal height.
        dem : HeightSurface, optional
            Surface that replaces a height; its slope propagates the error of its height to East and North.
        height_sigma_m : float
            Standard deviation of the height, or of the heights of the DEM.
        sigma_px : (line, sample), optional
            Standard deviations of the measurement; default: the median of the image, times sigma0.

        Raises
        ------
        InputError
            There is no such image; not exactly one height is given; the pixel is outside the image; the ray misses the
            surface.
        NoSolutionError
            There is no covariance.
        """
        from fg_orient.quality.located_point import locate

        return locate(
            self._orientation,
            image,
            (line, sample),
            height_m=height_m,
            dem=dem,
            height_sigma_m=height_sigma_m,
            sigma_px=sigma_px,
        )

    def intersect(
        self, pixels: Mapping[str, tuple[float, float]], *, sigma_px: tuple[float, float] | None = None
    ) -> LocatedPoint:
        """Intersect rays of two or more images with the adjusted orientation; see :meth:`locate`.

        ``pixels`` contains line and sample of the point by image id.
        """
        from fg_orient.quality.located_point import intersect

        return intersect(self._orientation, pixels, sigma_px=sigma_px)

    @property
    def _orientation(self) -> Orientation:
        from fg_orient.quality.located_point import Orientation

        scale = self.scale if np.isfinite(self.scale) else 1.0  # without redundancy
        return Orientation(self.problem, self.state, self.required_cofactors(), scale)

    def reliability(self, *, alpha: float = ALPHA, power: float = POWER) -> BlockReliability:
        """Return the redundancy numbers, minimal detectable biases and their effects, of all observations.

        See ``fg_orient.quality.reliability``; sigmas are a priori.

        Parameters
        ----------
        alpha, power : float
            Probabilities of a false alarm and of detecting the minimal detectable bias, 0 < alpha < power < 1.

        Raises
        ------
        InputError
            The probabilities are invalid.
        NoSolutionError
            There is no covariance, or a loss is set: its weights change both probabilities.
        """
        self._require_unweighted("statistics.reliability_weighted")
        known: dict[tuple[float, float], BlockReliability] = self.__dict__.setdefault("_reliability", {})
        if (alpha, power) not in known:
            known[alpha, power] = reliability(self.residual_cofactors, alpha=alpha, power=power)
        return known[alpha, power]

    def suspicious(
        self, *, level: float | None = None, test: str | None = None, control: str | None = None, kind: Kind = "groups"
    ) -> tuple[GroupTest, ...]:
        """Return the observations suspected of a gross error; see :meth:`outlier_tests`."""
        return self.outlier_tests(level=level, test=test, control=control, kind=kind).suspicious()

    def global_test(self, *, level: float = 0.001) -> GlobalTest | None:
        """Test the whole model by chi-square (``fg_orient.quality.hypotheses``); None without redundancy.

        NoSolutionError: a loss has changed the sum of squares, or variance components were estimated from it.
        """
        self._require_unweighted("statistics.global_weighted")
        if self.components is not None:
            raise NoSolutionError.of("statistics.components_global", place=self.block.name)
        return global_test(self.chi2, self.redundancy, level)

    def variance_components(
        self, *, groups: tuple[str, ...] = USUAL_GROUPS, method: Method = "helmert"
    ) -> VarianceComponents:
        """Return the variance components of groups of observations from this solution.

        See ``fg_orient.quality.variance_components``; ``adjust(variance_components=...)`` iterates. NoSolutionError:
        there is no covariance, or it contains the weights of a loss.
        """
        self.required_cofactors(unweighted="statistics.components_loss")
        return variance_components(self.residual_cofactors, groups=groups, method=method)

    def in_datum(self, *names: str) -> FreeNetwork:
        """Transform a free network to the datum of images ("image:3") and points ("point:12").

        Without names, the datum of the adjustment is used: inner constraints on all ground points.

        NoSolutionError: this is not a free network (``datum = "inner"``), or there is no covariance. InputError: an
        image or point is unknown, or they do not fix all motions.
        """
        from fg_orient.quality.free_network import FreeNetwork

        if not isinstance(self.cofactors, FreeNetwork):
            raise NoSolutionError.of("statistics.no_free_network", place=self.block.options.datum)
        return self.cofactors.in_datum(*names) if names else self.cofactors

    def significance(self, *, level: float = SIGNIFICANCE_LEVEL) -> Significance:
        """Test all unknowns of the images and groups of them; see ``fg_orient.quality.significance``.

        NoSolutionError: there is no covariance, a loss, no redundancy, or variance components in a block too large for
        their degrees of freedom.
        """
        self.required_cofactors(unweighted="statistics.significance_weighted")
        return significance(self.residual_cofactors, self.sigma0, self.unknown_freedom, level=level)

    def prediction_test(self) -> PredictionTest:
        """Compare predicted and actual accuracy at check points; see ``fg_orient.quality.accuracy``.

        NoSolutionError: no covariance, no check points, or check points that are not unknowns.
        """
        from fg_orient.quality.accuracy import prediction_test

        self.required_cofactors()
        return prediction_test(self.accuracy.check)

    @cached_property
    def regularisation(self) -> dict[str, Any] | None:
        """Record of a regularisation, or of a Tikhonov solver of the dense backend; None without both.

        See ``fg_orient.quality.resolution`` and, for the solver, ``fg_orient.quality.conditioning``.
        """
        if self.problem.regularisation is not None:
            from fg_orient.quality.resolution import record_of

            return record_of(self.weighted, self.state, self.cofactors)
        if not self.solver:  # other backends do not need the kappa rules, which are slow to load
            return None
        from fg_orient.quality.conditioning import regularisation

        return regularisation(self.weighted, self.solver, self.log)

    def compare_dem(self, dem: HeightSurface | str | Path, *, role: str | None = None) -> DemComparison:
        """Compare adjusted heights (of one role: "control", "check", "tie") with a DEM of ellipsoidal heights.

        InputError: the DEM cannot be read, it contains none of these points, or the block is not georeferenced.

        Parameters
        ----------
        dem : RasterDem or path
            Ellipsoidal heights, m.
        role : str, optional
            Default: all points.
        """
        from fg_orient.quality.dem_accuracy import compare_points

        return compare_points(self.block, self.ground_m, dem, role)

    @cached_property
    def result(self) -> Result:
        """Record of this solution: content of the result folder, tables."""
        from fg_orient.result.summary import result_of
        from fg_orient.rpc.files import corrected_models

        project = Path(self.block.sources[0].path) if self.block.sources else Path()
        return result_of(self, corrected_models(self), folder=project.parent)

    def save(self, folder: str | Path, *, overwrite: bool = False) -> Result:
        """Write the result folder like ``fg-orient adjust``, completely or not at all.

        :func:`fg_orient.read_result` reads it; ``fg-orient replay`` requires a folder of ``fg-orient adjust``.
        ``overwrite`` replaces an existing result folder. InputError: the folder exists or cannot be written.
        """
        from fg_orient.formats.atomic import require_free, staged_folder, writing
        from fg_orient.report import write_page
        from fg_orient.report.pictures import rasters_of
        from fg_orient.result.manifest import write_manifest
        from fg_orient.result.provenance import ground_system

        require_free(Path(folder), overwrite=overwrite)
        result = replace(self.result, record={**self.result.record, "out": Path(folder).name})
        with staged_folder(folder, overwrite=overwrite) as staging, writing(folder):
            rasters = rasters_of(result, self.block.images, staging)
            result.record.update(rasters | ground_system(self.block, staging))
            result.write(staging)
            write_page(staging, result)
            write_manifest(staging, result.record)
        return result

    def to_frame(self, table: str = "points") -> pandas.DataFrame:
        """Return a table as ``pandas.DataFrame``; see :meth:`fg_orient.Result.to_frame`."""
        return self.result.to_frame(table)

    def to_geo(self) -> dict[str, Any]:
        """Return the points as a GeoJSON FeatureCollection; see :meth:`fg_orient.Result.to_geo`."""
        return self.result.to_geo()

    def _overview(self) -> dict[str, Any]:
        accuracy = {"check": self.accuracy.check.statistics()}
        return overview(
            {
                "name": self.block.name,
                "status": str(self.status),
                "sigma0": self.sigma0,
                "redundancy": self.redundancy,
                "n_image_points": len(self.problem.observations),
                "iterations": self.iterations,
                "backend": self.backend,
                "accuracy": accuracy,
            }
        )

    def __repr__(self) -> str:
        return one_line("Solution", self._overview())

    def _repr_html_(self) -> str:
        return html_table("Solution", self._overview())
