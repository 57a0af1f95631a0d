"""LIBERO-PRO's package, as RLinf names it (`LIBERO_TYPE=pro`), on rollout-libero's simulator.

It has LIBERO's modules. Its folders also have the task files of LIBERO-PRO's sixteen suites."""
