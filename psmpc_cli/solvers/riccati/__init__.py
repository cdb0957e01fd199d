"""An interior-point method of our own for a window's quadratic programs, in C, on the double integrators' structure."""
