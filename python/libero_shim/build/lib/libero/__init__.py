"""LIBERO's package, as its environments' users see it, on rollout-libero's simulator."""

import sys

from libero._absent import AbsentModules

sys.meta_path.append(AbsentModules)  # type: ignore[arg-type]
