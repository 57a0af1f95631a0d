"""The first release's policy server, unchanged, for tests. It runs in a
separate process because its messages have the same names as this package's.

It uses no module of this package, implements proto/released/policy_v1.proto, whose
code it generates at the start, and must not be updated.
"""

import importlib
import pathlib
import sys
import tempfile
import threading
from concurrent import futures

import grpc
import numpy as np
from grpc_tools import protoc

RELEASED = pathlib.Path(__file__).resolve().parents[2] / "proto" / "released"


def generated():
    """Returns the modules of the released protocol."""
    with tempfile.TemporaryDirectory() as folder:
        status = protoc.main(
            ["protoc", f"-I{RELEASED}", f"--python_out={folder}", f"--grpc_python_out={folder}",
             "policy_v1.proto"]
        )  # fmt: skip
        assert status == 0, f"protoc ended with {status}"
        sys.path.insert(0, folder)
        return importlib.import_module("policy_v1_pb2"), importlib.import_module(
            "policy_v1_pb2_grpc"
        )


pb, pb_grpc = generated()


class Service(pb_grpc.PolicyServicer):
    """Answers with noise of (seed, query), two actions at a time."""

    def __init__(self):
        self.sessions = {}
        self.turn = threading.Lock()

    def Describe(self, request, context):
        if request.protocol_version != 1:
            context.abort(grpc.StatusCode.FAILED_PRECONDITION, "this server speaks version 1")
        return pb.DescribeResponse(
            protocol_version=1,
            name="released",
            cameras=[pb.CameraRequest(name="agentview", width=32, height=32)],
            state=[pb.STATE_FIELD_EEF_POS],
            horizon=2,
            execute=2,
            stochastic=True,
            language=pb.LANGUAGE_FREE_FORM,
            max_batch=4,
        )

    def Reset(self, request, context):
        with self.turn:
            self.sessions[request.session] = request.seed
        return pb.ResetResponse()

    def Infer(self, request, context):
        answer = self.answer(request)
        if answer is None:
            context.abort(grpc.StatusCode.UNAVAILABLE, f"{request.session!r} is not open")
        return answer

    def InferBatch(self, request, context):
        answers = [self.answer(query) for query in request.queries]
        return pb.InferBatchResponse(
            results=[
                pb.InferResult(error="not open") if one is None else pb.InferResult(response=one)
                for one in answers
            ]
        )

    def answer(self, query):
        with self.turn:
            seed = self.sessions.get(query.session)
        if seed is None:
            return None
        assert len(query.observation.images[0].rgb) == 32 * 32 * 3
        noise = np.random.default_rng([seed, query.query_index]).uniform(-1, 1, 14)
        return pb.InferResponse(actions=noise.astype(np.float32).tolist(), action_width=7)


def main():
    server = grpc.server(futures.ThreadPoolExecutor(32))
    pb_grpc.add_PolicyServicer_to_server(Service(), server)
    serving = grpc.unary_unary_rpc_method_handler(lambda request, context: b"\x08\x01")
    server.add_generic_rpc_handlers(
        (grpc.method_handlers_generic_handler("grpc.health.v1.Health", {"Check": serving}),)
    )
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    print(f"listening on 127.0.0.1:{port}", flush=True)
    server.wait_for_termination()


if __name__ == "__main__":
    main()
