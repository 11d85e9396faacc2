"""Synthetic blocks in the real file formats, with the truth beside them.

``simulate_zonguldak`` writes the SPOT-5 stereo twin of the published experiments,
``simulate_block`` a block of any size, ``simulate_mixed`` one of three kinds of sensors; ``zonguldak_block``,
``grid_block`` and ``mixed_block`` give the same blocks in memory.
"""
