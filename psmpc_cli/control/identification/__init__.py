"""What the controller finds out while it runs: the delay of commands, masses of the robot, and the held load."""
