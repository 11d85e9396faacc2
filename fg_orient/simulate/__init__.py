"""Synthetic blocks in the real file formats, with the truth beside them.

``simulate_zonguldak`` writes the SPOT-5 stereo twin of the published experiments,
``simulate_block`` a block of any size; ``zonguldak_block`` and ``grid_block`` give the same
blocks in memory.
"""
