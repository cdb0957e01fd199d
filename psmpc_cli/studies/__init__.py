"""Studies: many runs of one task, in parallel, and what they say together."""
