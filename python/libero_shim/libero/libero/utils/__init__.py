"""Of LIBERO's utilities those that programs which run its environments import."""
