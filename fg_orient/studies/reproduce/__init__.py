"""Compare published and reproduced values; only this package reads both."""
