"""LIBERO's package, with the interface of its environments, on rollout-libero's simulator."""

import sys

from libero._absent import AbsentModules

sys.meta_path.append(AbsentModules)
