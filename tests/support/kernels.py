"""Adjust small blocks of each kind once, so that the kernels which most tests call are compiled and kept.

``python -m tests.support.kernels`` runs before the tests: else each of their processes would compile them for itself.
"""

from __future__ import annotations

import fg_orient as fg
from benchmarks.frames import Size, network
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block
from tests.support.rpc_block import rpc_twin


def main() -> None:
    """Adjust the twin with its rigorous models and with RPC, by each backend, and a free network of frame images."""
    for block in (zonguldak_block(ZonguldakOptions())[0], rpc_twin("affine").block):
        for backend in ("schur", "graph", "dense"):
            fg.adjust(block, backend=backend)
    for n_parameters in (8, 10):  # the equations of frame images without and with further coefficients
        fg.adjust(network(Size(11, 200, 5, n_parameters, 2, 0.0))[0])
    fg.adjust(network(Size(60, 12, 0, 8, 2, 0.0))[0])  # images are eliminated first


if __name__ == "__main__":
    main()
