"""Kinematics and dynamics of multi-arm space robots as CasADi functions."""
