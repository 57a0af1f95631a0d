"""LIBERO-Plus' package, as RLinf names it (`LIBERO_TYPE=plus`), on rollout-libero's simulator."""
