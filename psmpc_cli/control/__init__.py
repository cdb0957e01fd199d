"""Controllers: the moving sequence, warm starts, and what each sample decides."""
