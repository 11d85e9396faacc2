"""Published and modern linear solvers, Tikhonov regularisation, conditioning; numpy and scipy only."""
