"""The grammar that ``wordings`` draws from: how people ask for the forty tasks.

A slot of a template is filled from the task's own entries or, if the task has none, from ``words``.
A construction is the kind of action that a task asks for. A construction has four kinds of clause,
which ``FRAMES`` turn into sentences:

- ``do``: an imperative, "put the bowl on the plate";
- ``doing``: a gerund, "putting the bowl on the plate";
- ``must``: a whole sentence about the objects, "the bowl belongs on the plate";
- ``is``: the final state, "the bowl is on the plate".

All entries were written without looking at the paraphrases of the benchmark's language axis, which
are held out from training."""

from training.grammar.sentences import FRAMES
from training.grammar.tasks import TASKS
from training.grammar.template import Grammar, Templates

__all__ = ["FRAMES", "TASKS", "Grammar", "Templates"]
