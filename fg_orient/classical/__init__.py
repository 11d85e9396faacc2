"""The published procedures: Gauss-Markov and Gauss-Helmert adjustment, the two-stage orientation of stereo pairs."""
