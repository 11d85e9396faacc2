"""Compiled programs adjust the pinhole problem: Ceres through pycolmap, and GTSAM's GeneralSFMFactor."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import gtsam
import numpy as np
import pycolmap

from benchmarks.entries import FUNCTION_TOLERANCE, LIMIT_S, MAX_EVALUATIONS, Outcome, ceres_outcome
from benchmarks.own import repeated
from benchmarks.pinhole import Pinhole

#: The images have this side, px; only a check of the program uses it.
SIDE_PX = 10_000


def reconstruction(p: Pinhole) -> pycolmap.Reconstruction:
    """Return cameras (RADIAL: f, cx, cy, k1, k2; fixed principal point), images, and points with their tracks."""
    scene = pycolmap.Reconstruction()
    order = np.argsort(p.image, kind="stable")
    first = np.searchsorted(p.image[order], np.arange(len(p.rotation) + 1))
    within = np.empty(len(order), int)
    within[order] = np.arange(len(order)) - first[p.image[order]]
    for i, (rotation, centre, (focal, k1, k2)) in enumerate(zip(p.rotation, p.centre, p.interior, strict=True)):
        camera = pycolmap.Camera(
            model="RADIAL", width=SIDE_PX, height=SIDE_PX, params=[focal, 0.0, 0.0, k1, k2], camera_id=i + 1
        )
        scene.add_camera_with_trivial_rig(camera)
        image = pycolmap.Image(
            name=str(i), keypoints=p.pixel[order[first[i] : first[i + 1]]], camera_id=i + 1, image_id=i + 1
        )
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), -rotation @ centre)
        scene.add_image_with_trivial_frame(image, pose)
    rays = np.argsort(p.point, kind="stable")
    ends = np.searchsorted(p.point[rays], np.arange(len(p.ground) + 1))
    for j, ground in enumerate(p.ground):
        seen = rays[ends[j] : ends[j + 1]]
        track = pycolmap.Track([pycolmap.TrackElement(int(p.image[a]) + 1, int(within[a])) for a in seen])
        scene.add_point3D(ground, track)
    return scene


def ceres(p: Pinhole, threads: int) -> Callable[[], Outcome]:
    """Return Ceres with COLMAP's costs and choice of linear solver; the decrease of the cost ends it."""

    def once() -> Outcome:
        start = time.perf_counter()
        scene, config = reconstruction(p), pycolmap.BundleAdjustmentConfig()
        for i in range(len(p.rotation)):
            config.add_image(i + 1)
        options = pycolmap.BundleAdjustmentOptions()
        options.print_summary = False
        options.ceres.min_num_residuals_for_cpu_multi_threading = 0
        solver = options.ceres.solver_options
        solver.num_threads, solver.max_num_iterations = threads, MAX_EVALUATIONS
        solver.max_solver_time_in_seconds = LIMIT_S
        solver.function_tolerance = FUNCTION_TOLERANCE
        adjuster = pycolmap.create_default_ceres_bundle_adjuster(options, config, scene)
        made = time.perf_counter()
        summary = adjuster.solve().ceres_summary
        seconds = time.perf_counter() - made
        used = f"{summary.linear_solver_type_used.name}, {summary.num_threads_used} threads"
        return ceres_outcome(summary, made - start, seconds, used, 1.0 / p.sigma**2)

    return repeated(once)


def adjuster(
    p: Pinhole, scene: pycolmap.Reconstruction, threads: int, limit_s: float, linear_solver: str, eta: float
) -> Any:
    """Return Ceres' problem with the costs of COLMAP and this linear solver.

    Its log goes to the standard output. ``eta`` is the relative accuracy of an iterative
    solver.
    """
    config, options = pycolmap.BundleAdjustmentConfig(), pycolmap.BundleAdjustmentOptions()
    for i in range(len(p.rotation)):
        config.add_image(i + 1)
    options.print_summary, ceres = False, options.ceres
    ceres.min_num_residuals_for_cpu_multi_threading = 0
    ceres.auto_select_solver_type = False
    solver = ceres.solver_options
    # the enumerations are given by name because pycolmap does not export their classes
    solver.linear_solver_type = linear_solver
    if linear_solver == "ITERATIVE_SCHUR":
        solver.preconditioner_type, solver.eta = "SCHUR_JACOBI", eta
    solver.num_threads, solver.max_num_iterations = threads, MAX_EVALUATIONS
    solver.max_solver_time_in_seconds = limit_s
    solver.gradient_tolerance, solver.function_tolerance = 1e-30, 1e-13
    solver.logging_type, solver.minimizer_progress_to_stdout = "PER_MINIMIZER_ITERATION", True
    return pycolmap.create_default_ceres_bundle_adjuster(options, config, scene)


def gtsam_sfm(p: Pinhole) -> Callable[[], Outcome]:
    """Return GTSAM's Levenberg-Marquardt on GeneralSFMFactorCal3Bundler; it eliminates the points first."""

    def once() -> Outcome:
        start = time.perf_counter()
        graph, values, ordering = gtsam.NonlinearFactorGraph(), gtsam.Values(), gtsam.Ordering()
        noise = gtsam.noiseModel.Isotropic.Sigma(2, p.sigma)
        cameras = [gtsam.symbol("c", i) for i in range(len(p.rotation))]
        points = [gtsam.symbol("p", j) for j in range(len(p.ground))]
        for image, point, pixel in zip(p.image.tolist(), p.point.tolist(), p.pixel, strict=True):
            graph.add(gtsam.GeneralSFMFactorCal3Bundler(gtsam.Point2(*pixel), noise, cameras[image], points[point]))
        for key, rotation, centre, (focal, k1, k2) in zip(cameras, p.rotation, p.centre, p.interior, strict=True):
            pose = gtsam.Pose3(gtsam.Rot3(rotation.T), centre)
            values.insert(key, gtsam.PinholeCameraCal3Bundler(pose, gtsam.Cal3Bundler(focal, k1, k2, 0.0, 0.0)))
        for key, ground in zip(points, p.ground, strict=True):
            values.insert(key, ground)
            ordering.push_back(key)
        for key in cameras:
            ordering.push_back(key)
        params = gtsam.LevenbergMarquardtParams.CeresDefaults()
        params.setOrdering(ordering)
        params.setMaxIterations(MAX_EVALUATIONS)
        params.setRelativeErrorTol(FUNCTION_TOLERANCE)
        optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values, params)
        made = time.perf_counter()
        optimizer.optimize()
        seconds = time.perf_counter() - made
        n = int(optimizer.iterations())
        return Outcome(seconds, made - start, n, n, float(optimizer.error()), "its own rule")

    return repeated(once)
