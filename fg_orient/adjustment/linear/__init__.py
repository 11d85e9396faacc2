"""Published and modern linear solvers, Tikhonov regularisation and conditioning; only numpy and scipy are used."""
