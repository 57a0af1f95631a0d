"""What policies do to observations and actions around their networks.

Pure functions of NumPy arrays, one module each for frames (`images`, `jpeg`),
readings (`robot`) and actions (`actions`). Nothing here loads a model or knows
a policy's name; each function says whose definition it follows.
"""
