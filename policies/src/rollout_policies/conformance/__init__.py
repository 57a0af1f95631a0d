"""Conformance check of a policy: the points that `check` and `python -m
rollout_policies check URL` examine, as `policy-gateway check` does.

It checks the protocol, not the quality of the policy: the observations are synthetic.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from ..policy import Policy, description_of
from ..server import Server
from .points import Finding, examine
from .probe import CannotCheck, Probe, Target

__all__ = ["CannotCheck", "DoesNotConform", "Finding", "Target", "check", "check_server"]


class DoesNotConform(AssertionError):
    """A policy violates the protocol; the message lists the violated points."""

    def __init__(self, findings: list[Finding]) -> None:
        failed = [str(finding) for finding in findings if finding.verdict.failed]
        super().__init__("\n".join(["the policy does not conform:", *failed]))
        self.findings = findings


def check(policy: Policy, *, suite: str = "libero_object") -> list[Finding]:
    """Checks a policy in this process, for its unit tests.

    The policy is served on the loopback address, and its methods run in this thread, for
    episodes of a task of `suite`. Returns the findings. Raises DoesNotConform,
    and CannotCheck if the policy answers no query.
    """
    server = Server(policy, description_of(policy), "127.0.0.1:0")
    outcome: list[list[Finding] | BaseException] = []

    def run_check() -> None:
        try:
            outcome.append(check_server(Target(f"grpc://{server.address}", suite=suite)))
        except BaseException as error:
            outcome.append(error)
        finally:
            server.stop(0)

    thread = threading.Thread(target=run_check, name="check", daemon=True)
    thread.start()
    server.work()
    thread.join()
    [findings] = outcome
    if isinstance(findings, BaseException):
        raise findings
    if any(finding.verdict.failed for finding in findings):
        raise DoesNotConform(findings)
    return findings


def check_server(
    target: Target, report: Callable[[Finding], None] = lambda _: None
) -> list[Finding]:
    """Checks the server at an address, and passes each finding to `report` at
    once. Raises CannotCheck."""
    findings = []
    with Probe(target) as probe:
        for finding in examine(probe):
            findings.append(finding)
            report(finding)
    return findings
