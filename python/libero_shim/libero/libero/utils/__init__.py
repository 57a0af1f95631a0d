"""The subset of LIBERO's utilities that programs with its environments import."""
