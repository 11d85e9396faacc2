"""Causes of the published ill-conditioned systems: the computation behind docs/ill-conditioning.md.

    python examples/ill_conditioning.py [--seeds N] [--out FOLDER]

The script prints the values of that page. It uses the synthetic block of the published experiments (1 px of image
noise). With ``--out`` it also draws three figures (this needs matplotlib): errors after step 2, velocity and yaw, and
the constant residual. ``fg-orient compare`` makes the heat maps and spectra of the page.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from factors.cameras.pushbroom import RECORD
from fg_orient.geodesy import ecef_to_geodetic, enu_from_ecef
from fg_orient.model.names import EOP_SETS
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block
from fg_orient.studies.claims import EXACT, TWIN, Study
from fg_orient.studies.conditions import Conditions
from fg_orient.studies.two_stage import TwoStage

SETS = (1, 9, 15, 5, 13, 17, 19, 20)
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
#: Synthetic block with the radial velocity and attitude of a real SPOT 5 file.
AS_RUN = ZonguldakOptions(
    image_noise_px=1.0, distortion_rad=3e-6, radial_velocity_m_s=8.0, attitude_rad=(-1.6e-4, -7.2e-4, 9e-4)
)


def main() -> None:
    """Print the values; draw figures with ``--out``."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    studies = [Study(seed) for seed in range(1, arguments.seeds + 1)]
    wild = step_two(studies)
    samples, effects = velocity_as_yaw(studies[0].two_stage)
    east_north, errors = constant_residual()
    if arguments.out:
        arguments.out.mkdir(parents=True, exist_ok=True)
        draw(arguments.out, wild, (samples, effects), (east_north, errors))
        print(f"figures: {arguments.out}")


def step_two(studies: list[Study]) -> dict[tuple[int, str], list[float]]:
    """Misclosures before step 2, and the control-point errors after it."""
    before = [float(np.sqrt(np.mean(s.two_stage.look.v_rad**2))) for s in studies]
    after = [float(np.abs(s.two_stage.look.largest_misclosure)) for s in studies]
    print(f"misclosure before step 1 {np.median(before):.1e} rad, after it {np.median(after):.1e} at most")
    out: dict[tuple[int, str], list[float]] = {}
    for eop_set in SETS:
        for name in EXACT:
            out[eop_set, name] = [s.bundle(eop_set, 1, name).accuracy.gcp_max for s in studies]
        values = np.array([out[eop_set, name] for name in EXACT])
        finite = values[np.isfinite(values)]
        icp = [s.bundle(eop_set, 1, EXACT[4]).accuracy.icp_max for s in studies]
        print(
            f"set {eop_set:2d} {EOP_SETS[eop_set].name:5s} "
            f"control points {finite.min():8.1e} to {finite.max():8.1e} m, "
            f"no solution {np.isnan(values).mean():4.0%}, check points {np.median(icp):.1f} m"
        )
    return out


def velocity_as_yaw(two_stage: TwoStage) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Effects of a velocity change and of a yaw on the along-track condition."""
    at = two_stage.pre_adjusted
    left = np.flatnonzero(at.image == 0)
    at = at.take(left[np.argsort(at.records[left, RECORD.s])])
    slopes = at.linearise((9, 12, 15, 24), np.zeros((2, 4))).eop  # V_X, V_Y, V_Z, yaw: constant terms
    effects = {}
    for name, unit in frame(at).items():
        effects[name] = np.einsum("nij,nj->ni", slopes[:, :, :3], unit)
    speed = np.linalg.norm(at.records[:, RECORD.velocity], axis=1)
    effects["yaw"] = slopes[:, :, 3] / -speed[:, None]
    across, yaw = effects["velocity across track"], effects["yaw"]
    print(
        f"velocity along track and radial: {max(np.abs(effects[k]).max() for k in list(effects)[:2]):.1e} rad per m/s;"
    )
    print(f"across track {np.abs(across).max():.1e}; it differs from a yaw by {np.abs(across - yaw).max():.1e}")
    return two_stage.block.images[0].sensor.n_samples / 2.0 * (1.0 + at.records[:, RECORD.s]), effects


def frame(at: Conditions) -> dict[str, np.ndarray]:
    """Unit vectors along track (of V), radial (of P) and across track (of V x P)."""
    p, v = at.records[:, RECORD.position], at.records[:, RECORD.velocity]
    named = {"velocity along track": v, "velocity radial": p, "velocity across track": np.cross(v, p)}
    return {name: vector / np.linalg.norm(vector, axis=1, keepdims=True) for name, vector in named.items()}


def constant_residual() -> tuple[np.ndarray, np.ndarray]:
    """Control-point errors after step 1 as the authors' program computes them, and with orthonormal matrices."""
    block, _ = zonguldak_block(AS_RUN)
    for as_run in (False, True):
        found = TwoStage(block, as_run=as_run).look_only()
        mean, scatter = found.gcp_m.mean(axis=0), found.gcp_m.std(axis=0)
        print(
            f"{'as run' if as_run else 'orthonormal'}: control-point RMSE {np.round(found.gcp_rmse, 3)} m, mean "
            f"{np.linalg.norm(mean):.3f} m, scatter {scatter.max():.3f} m"
        )
    lon, lat, _ = ecef_to_geodetic(block.points.known.ecef_m[~np.isnan(block.points.known.ecef_m).any(axis=1)])
    enu = enu_from_ecef(lon, lat)
    return np.stack([lon, lat], axis=1), np.einsum("nij,nj->ni", enu, found.gcp_m)


def draw(out: Path, wild: dict, yaw: tuple, residual: tuple) -> None:
    """Write the figures as SVG."""
    import matplotlib

    matplotlib.use("svg")
    import matplotlib.pyplot as plt

    plt.rcParams.update({"svg.fonttype": "none", "svg.hashsalt": "fg_orient", "font.size": 9})
    pictures = {"control-errors": (draw_wild, wild), "velocity-yaw": (draw_yaw, yaw),
                "constant-residual": (draw_residual, residual)}  # fmt: skip
    for name, (picture, data) in pictures.items():
        figure, axes = plt.subplots(figsize=(7.2, 3.6), layout="constrained")
        picture(axes, data)
        figure.savefig(out / f"{name}.svg", metadata={"Date": None, "Creator": None})
        plt.close(figure)


def draw_wild(axes, data: dict) -> None:
    for j, name in enumerate(EXACT):
        for k, eop_set in enumerate(SETS):
            values = np.array(data[eop_set, name])
            label = name.replace("_", " ").replace("partial pivot", "partial-pivot") if k == 0 else None
            place = np.full(len(values), k + 0.12 * (j - 2.5))
            axes.semilogy(place, values, "osD^vP"[j], ms=3.5, color=COLOURS[j], label=label, alpha=0.8)
    axes.axhline(5.0, color="black", lw=0.8, ls="--")
    axes.annotate("5 m, one pixel", (0.0, 7.0), fontsize=8)
    axes.set_xticks(range(len(SETS)), [f"{s} {EOP_SETS[s].name}" for s in SETS])
    axes.set_xlabel("EOP set")
    axes.set_ylabel("control points, largest RMSE, m")
    axes.set_title(f"One bundle iteration, {TWIN.point_set}, one mark per seed: nothing but amplified rounding")
    axes.legend(fontsize=7, ncols=2, loc="upper left", bbox_to_anchor=(0.0, 0.88))


def draw_yaw(axes, data: tuple) -> None:
    samples, effects = data
    for k, (name, style) in enumerate(zip(effects, ("-", "--", "-", ":"), strict=True)):
        label = "yaw of -1/|V| rad" if name == "yaw" else f"1 m/s {name}"
        axes.plot(samples, effects[name][:, 1] * 1e6, style, color=COLOURS[k], lw=4 if k == 2 else 2, label=label)
    axes.set_xlabel("sample")
    axes.set_ylabel("change of F_psi_x, µrad")
    axes.set_title("Velocity enters through its across-track part only, and that part is a yaw")
    axes.legend(fontsize=8)


def draw_residual(axes, data: tuple) -> None:
    lon_lat, enu = data
    axes.quiver(
        lon_lat[:, 0], lon_lat[:, 1], enu[:, 0], enu[:, 1], angles="xy", scale_units="xy", scale=20.0, width=0.004,
        color=COLOURS[1],
    )  # fmt: skip
    axes.plot(lon_lat[:, 0], lon_lat[:, 1], ".", color="black", ms=4)
    size = np.hypot(*enu[:, :2].T).mean()
    axes.set_xlabel("longitude, degrees")
    axes.set_ylabel("latitude, degrees")
    axes.margins(0.1)
    up = enu[:, 2].mean()
    axes.set_title(f"Control points after step 1, as run: {size:.2f} m horizontally, {up:+.2f} m up, alike everywhere")


if __name__ == "__main__":
    main()
