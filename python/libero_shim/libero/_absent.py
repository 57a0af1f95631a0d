"""Parts of LIBERO that this package leaves out, with a remedy for each."""

from __future__ import annotations

_USE = "install the original LIBERO in another environment"

#: Modules of LIBERO that are left out, each with its remedy.
_MODULES = {
    "libero.configs": _USE,
    "libero.lifelong": f"it trains policies; {_USE}",
    **{
        f"libero.libero.utils.{module}": "only time_utils of LIBERO's utilities is included; get "
        f"folders from libero.libero.get_libero_path and videos from imageio; {_USE} otherwise"
        for module in (
            "bddl_generation_utils", "benchmark_utils", "dataset_utils", "download_utils",
            "mu_utils", "object_utils", "task_generation_utils", "utils", "video_utils",
        )
    },
    "libero.libero.benchmark.mu_creation": f"it makes new tasks; {_USE}",
    **{
        f"libero.libero.envs.{module}": "the environment's sim, get_object and parsed_problem "
        f"describe its simulation; {_USE} otherwise"
        for module in (
            "arenas", "base_object", "object_states", "objects", "predicates", "problems",
            "regions", "robots", "textures", "utils",
        )
    },
}  # fmt: skip


class AbsentModules:
    """A finder of modules, tried last; its error for an omitted module names the remedy."""

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> None:
        """Raises ImportError for modules of LIBERO that are omitted here."""
        remedy = _MODULES.get(name)
        if remedy is not None:
            raise ImportError(f"{name} is not part of rollout-libero-shim: {remedy}", name=name)


def absent_attribute(owner: str, name: str, remedy: str) -> AttributeError:
    """Returns the error for an attribute that LIBERO's object has, but not this package's."""
    return AttributeError(f"{owner} has no `{name}` in rollout-libero-shim: {remedy}")
