"""Synthetic blocks in the real file formats, with their truth.

``simulate_zonguldak`` writes the SPOT-5 stereo twin of the published experiments. ``simulate_block``
writes a block of any size, ``simulate_mixed`` a block of three kinds of sensors. ``zonguldak_block``,
``grid_block`` and ``mixed_block`` give the same blocks in memory.
"""

from __future__ import annotations

from fg_orient.model.public import names_of, on_first_use

_HOME = names_of(
    __name__,
    {
        "block": "grid_block simulate_block",
        "options": "BlockOptions MixedOptions ZonguldakOptions",
        "mixed": "mixed_block simulate_mixed",
        "zonguldak": "simulate_zonguldak zonguldak_block",
    },
)
__all__ = sorted(_HOME)
__getattr__ = on_first_use(globals(), _HOME)
