"""Figures that stand beside the paper's claims: what a claim measures, with the published value in it."""
