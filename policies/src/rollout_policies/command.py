"""A policy's command line, made from its constructor: what `run` does."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import inspect
import logging
import os
import sys
import types
import typing
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .access import AccessError, UnguardedAddress
from .actions import UnusableActions
from .policy import Policy, UnusableDescription, description_of, require_methods
from .server import CannotListen, require_servable, serve

#: Types of parameters that flags are made for.
FLAG_TYPES = (bool, int, float, str, Path)


def run(policy_class: type[Policy], arguments: Sequence[str] | None = None) -> None:
    """Makes a policy from the command line and serves it until it is stopped.

    Every parameter of the class's `__init__` becomes a flag: its type, one of
    bool, int, float, str and Path, is its annotation's or its default's, and
    `X | None` is taken, too. A parameter without a default must be given.
    Beside them are --listen, --tls-cert, --tls-key, --token-file, --insecure and
    --execute. --help shows the class's docstring. `arguments` are those of the
    process if None.

    Exits with 2 for a wrong command line, and with 1 and one line for a class that
    cannot be served and for what fails otherwise. Raises what the constructor, the
    warm-up and the policy's methods raise.
    """
    try:
        parser, own = _parser(policy_class)
        require_methods(policy_class)
    except (UnusableDescription, UnusableParameter) as error:
        sys.exit(f"error: {error}")
    given = parser.parse_args(arguments)
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(name)s: %(message)s")
    try:
        options = server_options(given)
        require_servable(**options)
    except UnguardedAddress as error:
        parser.error(str(error))
    except (AccessError, CannotListen) as error:
        sys.exit(f"error: {error}")
    # Models print while they load; the first line of the output is the address.
    with contextlib.redirect_stdout(sys.stderr):
        policy = policy_class(**{name: getattr(given, name) for name in own})
    try:
        if "execute" not in own and given.execute is not None:
            set_execute(policy, given.execute)
        serve(policy, **options)
    except UnusableExecute as error:
        parser.error(str(error))
    except UnusableActions as error:
        sys.exit(f"error: policy {policy_class.__name__} cannot be served: {error}")
    except (UnusableDescription, CannotListen) as error:
        sys.exit(f"error: {error}")


class UnusableParameter(TypeError):
    """No flag can be made for a constructor's parameter."""


class UnusableExecute(ValueError):
    """A policy cannot execute so many actions per query."""


def set_execute(policy: Policy, execute: int) -> None:
    """Has `execute` actions of every answer executed, whatever the policy's
    description said. Raises UnusableExecute."""
    try:
        policy.description = dataclasses.replace(description_of(policy), execute=execute)
    except ValueError as error:
        raise UnusableExecute(f"failed to use --execute {execute}: {error}") from error


def add_server_flags(parser: argparse.ArgumentParser) -> None:
    """The flags of every server of a policy."""
    server = parser.add_argument_group("server")
    server.add_argument(
        "--listen",
        default="127.0.0.1:0",
        metavar="ADDR",
        help="HOST:PORT; port 0 is a free one (default: %(default)s)",
    )
    server.add_argument(
        "--tls-cert",
        metavar="FILE",
        help="certificate chain of this server, PEM; clients then write https://",
    )
    server.add_argument("--tls-key", metavar="FILE", help="its private key, PEM")
    server.add_argument(
        "--token-file",
        metavar="FILE",
        default=os.environ.get("ROLLOUT_TOKEN_FILE") or None,
        help="who is let in, one `ROLE TOKEN` per line (or ROLLOUT_TOKEN_FILE, or the lines in"
        " ROLLOUT_TOKENS)",
    )
    server.add_argument(
        "--insecure",
        action="store_true",
        help="listens to other machines without TLS or without tokens: for networks that only"
        " trusted people reach",
    )


def server_options(given: argparse.Namespace) -> dict[str, Any]:
    """What the flags say, as `serve` takes it. Raises UnguardedAddress if a
    certificate comes without its key, or a key without its certificate."""
    pair = (given.tls_cert, given.tls_key)
    if any(pair) and not all(pair):
        raise UnguardedAddress("--tls-cert and --tls-key belong together: give both")
    return {
        "listen": given.listen,
        "tls": pair if all(pair) else None,
        "token_file": given.token_file,
        "insecure": given.insecure,
    }


def _parser(policy_class: type[Policy]) -> tuple[argparse.ArgumentParser, list[str]]:
    """The command line of a class, and which of its names are the class's own."""
    if not (isinstance(policy_class, type) and issubclass(policy_class, Policy)):
        raise UnusableDescription(
            f"run makes the policy itself: give it a subclass of rollout_policies.Policy, not"
            f" {policy_class!r}"
        )
    doc = inspect.cleandoc(policy_class.__doc__ or f"Serves {policy_class.__name__}.")
    parser = argparse.ArgumentParser(
        description=doc.replace("%(prog)", "%%(prog)"),
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    group = parser.add_argument_group("policy")
    own = []
    try:
        for parameter in inspect.signature(policy_class, eval_str=True).parameters.values():
            # What is caught in bulk has no names.
            if parameter.kind not in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
                _add_flag(group, policy_class, parameter)
                own.append(parameter.name)
        if "execute" not in own:
            group.add_argument(
                "--execute",
                type=int,
                metavar="N",
                help="actions of every answer that are executed (default: what the policy says)",
            )
        add_server_flags(parser)
    except argparse.ArgumentError as error:
        raise UnusableParameter(
            f"a parameter of {policy_class.__name__} is called like a flag of the server"
            f" ({error}); rename it"
        ) from error
    return parser, own


def _add_flag(
    group: argparse._ArgumentGroup, policy_class: type[Policy], parameter: inspect.Parameter
) -> None:
    flag = "--" + parameter.name.replace("_", "-")
    kind = _type_of(parameter)
    if kind is None or parameter.kind is parameter.POSITIONAL_ONLY:
        raise UnusableParameter(
            f"no flag can be made for parameter {parameter} of {policy_class.__name__}: annotate"
            " it with bool, int, float, str, Path or one of them `| None`, or make the policy"
            " yourself and call serve"
        )
    required = parameter.default is parameter.empty
    default = None if required else parameter.default
    shown = "" if required or default is None else f"default: {default}".replace("%", "%%")
    options: dict[str, Any] = {"dest": parameter.name, "required": required, "default": default}
    if kind is bool:
        # It says its default itself in some versions of Python.
        group.add_argument(flag, action=argparse.BooleanOptionalAction, help=shown, **options)
    else:
        help_ = shown or ("required" if required else "default: none")
        group.add_argument(flag, type=kind, metavar=kind.__name__.upper(), help=help_, **options)


def _type_of(parameter: inspect.Parameter) -> type | None:
    """Of which type a parameter is; None if no flag can be of it."""
    annotation = parameter.annotation
    if annotation is parameter.empty:
        unsaid = parameter.default is parameter.empty or parameter.default is None
        annotation = str if unsaid else type(parameter.default)
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        kinds = [one for one in typing.get_args(annotation) if one is not type(None)]
        annotation = kinds[0] if len(kinds) == 1 else None
    return annotation if annotation in FLAG_TYPES else None
