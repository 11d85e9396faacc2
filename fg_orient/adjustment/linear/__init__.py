"""Linear solvers of the publications and of today, Tikhonov regularisation, conditioning; numpy and scipy only."""
