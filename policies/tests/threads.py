"""A policy for test_inference.py that records the thread of each method call,
one line each in the file given by --notes."""

import threading

import numpy as np

from rollout_policies import Description, Policy, run


class Threads(Policy):
    """Records the thread of each method call."""

    description = Description(name="threads", max_batch=4)

    def __init__(self, notes: str):
        self.notes = open(notes, "a", buffering=1)
        self.note("__init__")

    def note(self, method):
        print(method, threading.get_ident(), file=self.notes)

    def warm_up(self):
        self.note("warm_up")
        print("a model that prints while it compiles")

    def prepare(self, observation):
        self.note("prepare")

    def reset(self, episode):
        self.note("reset")

    def infer(self, observation):
        self.note("infer")
        return np.zeros(7)

    def infer_batch(self, observations):
        self.note("infer_batch")
        return [np.zeros(7) for _ in observations]

    def end(self, episode):
        self.note("end")


if __name__ == "__main__":
    run(Threads)
