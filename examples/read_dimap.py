"""Read a DIMAP file (SPOT 1-5, SPOT 6/7, Pléiades), print its contents, and locate a pixel.

    python examples/read_dimap.py METADATA [LINE SAMPLE [HEIGHT_M]]

The script prints image data, the residuals of degree-2 polynomials fitted to the metadata
orientation, the differences at the frame points of the file, and the ground position of a
pixel ((0, 0) = centre of the first pixel; ellipsoidal height).
"""

from __future__ import annotations

import sys

import numpy as np

import fg_orient as fg
from fg_orient.model.names import COMPONENTS
from fg_orient.model.parameters import UNITS
from fg_orient.sensors.correction import fit_eop
from fg_orient.sensors.ground import frame_records, ground_records


def main() -> int:
    """Read the file, print its contents, locate a pixel."""
    if len(sys.argv) not in (2, 4, 5):
        print(__doc__)
        return 2
    try:
        sensor = fg.read_sensor(sys.argv[1])
    except fg.InputError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    meta = sensor.metadata
    print(f"{meta.mission} {meta.instrument} ({meta.format}), {meta.epoch}")
    print(f"{meta.n_lines} lines x {meta.n_samples} samples")
    for note in sensor.notes:
        print(f"note: {note}")
    _, residuals = fit_eop(sensor)
    print("degree-2 polynomials of the line leave at most:")
    for name, unit, largest in zip(COMPONENTS, UNITS, abs(residuals).max(axis=0), strict=True):
        print(f"  {name:<5} {largest:.2g} {unit}")
    for row in frame_records(sensor) if meta.frame_points else []:
        print(f"frame point {row['id']}: missed by {row['misfit_m']:.3f} m")
    line, sample = (
        (float(v) for v in sys.argv[2:4]) if len(sys.argv) > 2 else ((meta.n_lines - 1) / 2, sensor.last_sample / 2)
    )
    height = float(sys.argv[4]) if len(sys.argv) > 4 else 0.0
    ground = sensor.locate(line, sample, height_m=height)
    place = ground_records(["pixel"], np.array([line]), np.array([sample]), ground)[0]
    print(f"line {line:g}, sample {sample:g} at {height:g} m: {place['lon_deg']:.7f} E, {place['lat_deg']:.7f} N")
    back_line, back_sample = sensor.project(ground)
    print(f"and back: line {back_line[0]:.6f}, sample {back_sample[0]:.6f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
