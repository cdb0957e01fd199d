"""Robot descriptions: what a robot is, its actuators, and robots from URDF files with capsules that cover them."""
