"""Figures of a sweep over the priorities of two stages, drawn by `draw_sweep`. Paper Fig. 6."""
