"""A simulator that speaks the pipe with Python's own modules; its argument names its fault."""

import hashlib
import json
import os
import signal
import socket
import sys
import time

FAULT = sys.argv[1]
DESCRIPTION = {
    "protocol": 1,
    "name": "test",
    "tasks": [{"name": "reach", "instruction": "reach it", "max_steps": 5}],
    "cameras": [
        {"name": "agentview", "width": 6, "height": 4, "any_size": False},
        {"name": "robot0_eye_in_hand", "width": 6, "height": 4, "any_size": True},
    ],
    "state": {"eef_pos": 3},
    "action": ["gripper", "x", "y"],
    "control_hz": 20.0,
    "axes": ["camera"],
    "packages": {"test": "1.0 0123456789abcdef"},
    "driver": "",
    "reused": False,
}


class Arm:
    """A point that an action moves; success is x beyond 1."""

    def __init__(self):
        self.position = [0.0, 0.0, 0.0]
        self.cameras = []

    def state(self):
        width = 2 if FAULT == "shape" and self.position[0] else 3
        return {"eef_pos": self.position[:width]}

    def draw(self, file):
        for number, camera in enumerate(self.cameras):
            file.write(bytes([number + 1]) * (camera["width"] * camera["height"] * 3))
        file.flush()

    def reset(self, file, task, seed, cameras, perturb):
        self.__init__()
        self.cameras = cameras
        self.position[2] = seed / 1000 + (time.time() if FAULT == "unseeded" else 0)
        file.seek(0)
        self.draw(file)
        text = json.dumps([task, self.position, perturb])
        return {"digest": hashlib.sha256(text.encode()).hexdigest(), "state": self.state()}

    def step(self, file, actions, frames):
        if FAULT == "crash":
            os.kill(os.getpid(), signal.SIGSEGV)
        if FAULT == "hang":
            time.sleep(600)
        if FAULT == "raise":
            raise ValueError("the arm fell off")
        for _, x, y in actions:
            self.position[0] += x
            self.position[1] += y
        if frames:
            file.seek(0)
            self.draw(file)
        success = self.position[0] > 1
        return {"executed": len(actions), "success": success, "ended": False, "state": self.state()}


def main():
    stream = socket.socket(fileno=os.dup(0)).makefile("rw")
    arm, file = Arm(), None
    print("a library prints")
    for line in stream:
        ((request, fields),) = json.loads(line).items()
        if request == "close":
            return
        if request == "describe":
            file = open(fields["frames"], "r+b")
            answer = {"describe": {**DESCRIPTION, "protocol": 2 if FAULT == "version" else 1}}
            if FAULT == "nameless":
                answer["describe"]["action"] = ["x", ""]
        if FAULT == "missing":
            text = "No module named 'metaworld': pip install metaworld"
            answer = {"error": {"kind": "unusable", "message": text}}
        if request in ("reset", "step"):
            try:
                answer = {request: getattr(arm, request)(file, **fields)}
            except Exception as error:
                answer = {"error": {"kind": "failed", "message": f"{request} raised {error!r}"}}
        stream.write("no JSON\n" if FAULT == "text" else json.dumps(answer) + "\n")
        stream.flush()


main()
