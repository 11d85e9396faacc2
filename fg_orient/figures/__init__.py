"""Figures for papers: every plot of a result folder as SVG and PDF, with captions."""
