"""The switched optimal control problem: from stages to the NLP of a window, and back to a plan."""
