"""Figures and animation of a log: one figure a file, drawn by `psmpc_cli.figures.draw.draw`."""
