"""C code compiled on first use by the system's compiler and cached; every use of it works without a compiler too."""
