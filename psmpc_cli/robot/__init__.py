"""Kinematics and dynamics of free-floating multi-arm robots as CasADi functions."""
