"""Routes round what blocks the straight motion to a target: how they are planned, and how a robot follows one."""
