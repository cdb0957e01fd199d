"""One run: the closed loop, what it measures, its monitors and its summary."""
