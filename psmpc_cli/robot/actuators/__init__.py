"""What acts on the base of a robot: thrusters with their plumes, and reaction wheels."""
