"""Rational function models from control points or from a rigorous sensor: fitting, judging, choosing terms."""
