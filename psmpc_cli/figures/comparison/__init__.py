"""Figures of several controllers on one task: one figure a file, drawn by `draw_comparison`."""
