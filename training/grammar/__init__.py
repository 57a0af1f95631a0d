"""The grammar that ``wordings`` draws from: how people ask for the forty tasks.

A slot of a template is filled from the task's own entries first, then from ``words``. A
construction says what kind of thing a task asks for. It has four kinds of clause, which
``FRAMES`` make sentences of:

- ``do``: an imperative, "put the bowl on the plate";
- ``doing``: a gerund, "putting the bowl on the plate";
- ``must``: a whole sentence about the things, "the bowl belongs on the plate";
- ``is``: how things are in the end, "the bowl is on the plate".

All of it is written from general English.
"""

from training.grammar.sentences import FRAMES
from training.grammar.tasks import TASKS
from training.grammar.template import Grammar, Templates

__all__ = ["FRAMES", "TASKS", "Grammar", "Templates"]
