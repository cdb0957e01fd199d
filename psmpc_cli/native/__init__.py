"""C code compiled at run time by the system's compiler and kept in a cache; without a compiler nothing is lost."""
