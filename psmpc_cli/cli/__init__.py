"""The commands of `psmpc`, one a file: arguments, one library call, presentation."""
