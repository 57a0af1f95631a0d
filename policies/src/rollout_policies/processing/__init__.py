"""Processing of observations and actions around the policies' networks.

Pure functions of NumPy arrays: modules for frames (`images`, `jpeg`), readings (`robot`) and
actions (`actions`). Nothing here loads a model or depends on a policy; a function that
reproduces a published definition names it."""
