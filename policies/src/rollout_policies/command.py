"""A policy's command line, generated from its constructor for `run`."""

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

#: Parameter types for which flags can be generated.
FLAG_TYPES = (bool, int, float, str, Path)


def run(policy_class: type[Policy], arguments: Sequence[str] | None = None) -> None:
    """Creates a policy from the command line and serves it until the process is stopped.

    Every parameter of the class's `__init__` becomes a flag. The flag's type (bool, int, float, str
    or Path) is that of the parameter's annotation or default; `X | None` is accepted, too. A
    parameter without a default is required. Further flags are --listen, --tls-cert, --tls-key,
    --token-file, --insecure and --execute. --help shows the class's docstring. If `arguments` is
    None, the process's arguments are used.

    Exits with 2 for an invalid command line, and with 1 and one line for a class that cannot be
    served and for other failures. Propagates exceptions of the constructor, the warm-up and the
    policy's methods."""
    try:
        parser, parameters = _parser(policy_class)
        require_methods(policy_class)
    except (UnusableDescription, UnusableParameter) as error:
        sys.exit(f"error: {error}")
    flags = parser.parse_args(arguments)
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(name)s: %(message)s")
    try:
        options = server_options(flags)
        require_servable(**options)
    except (IncompletePair, UnguardedAddress) as error:
        parser.error(str(error))
    except (AccessError, CannotListen) as error:
        sys.exit(f"error: {error}")
    # Models print while they load, but the first line of stdout must be the address.
    with contextlib.redirect_stdout(sys.stderr):
        policy = policy_class(**{name: getattr(flags, name) for name in parameters})
    try:
        if "execute" not in parameters and flags.execute is not None:
            set_execute(policy, flags.execute)
        serve(policy, **options)
    except UnusableExecute as error:
        parser.error(str(error))
    except UnusableActions as error:
        sys.exit(f"error: policy {policy_class.__name__} cannot be served: {error}")
    except (UnusableDescription, CannotListen) as error:
        sys.exit(f"error: {error}")


class UnusableParameter(TypeError):
    """A constructor's parameter cannot be turned into a flag."""


class UnusableExecute(ValueError):
    """A policy cannot execute this number of actions per query."""


def set_execute(policy: Policy, execute: int) -> None:
    """Sets the number of executed actions of every answer in the policy's
    description. Raises UnusableExecute."""
    try:
        policy.description = dataclasses.replace(description_of(policy), execute=execute)
    except ValueError as error:
        raise UnusableExecute(f"failed to use --execute {execute}: {error}") from error


def add_server_flags(parser: argparse.ArgumentParser) -> None:
    """Adds the flags that every policy server has."""
    server = parser.add_argument_group("server")
    server.add_argument(
        "--listen",
        default="127.0.0.1:0",
        metavar="ADDR",
        help="HOST:PORT; port 0 selects a free port (default: %(default)s)",
    )
    server.add_argument(
        "--tls-cert",
        metavar="FILE",
        help="certificate chain of this server, PEM; clients then write https://",
    )
    server.add_argument("--tls-key", metavar="FILE", help="the certificate's private key, PEM")
    server.add_argument(
        "--token-file",
        metavar="FILE",
        default=os.environ.get("ROLLOUT_TOKEN_FILE") or None,
        help="accepted tokens, one `ROLE TOKEN` per line (or ROLLOUT_TOKEN_FILE, or the lines in"
        " ROLLOUT_TOKENS)",
    )
    server.add_argument(
        "--insecure",
        action="store_true",
        help="listen to other machines without TLS or without tokens: for networks that only"
        " trusted people reach",
    )


def server_options(flags: argparse.Namespace) -> dict[str, Any]:
    """Returns the flags as arguments of `serve`. Raises IncompletePair."""
    pair = (flags.tls_cert, flags.tls_key)
    if any(pair) and not all(pair):
        raise IncompletePair("--tls-cert and --tls-key belong together: give both")
    return {
        "listen": flags.listen,
        "tls": pair if all(pair) else None,
        "token_file": flags.token_file,
        "insecure": flags.insecure,
    }


def _parser(policy_class: type[Policy]) -> tuple[argparse.ArgumentParser, list[str]]:
    """Returns the command line of a class, and the names of its constructor's parameters."""
    if not (isinstance(policy_class, type) and issubclass(policy_class, Policy)):
        raise UnusableDescription(
            f"run creates the policy itself: give it a subclass of rollout_policies.Policy, not"
            f" {policy_class!r}"
        )
    doc = inspect.cleandoc(policy_class.__doc__ or f"Serves {policy_class.__name__}.")
    parser = argparse.ArgumentParser(
        # argparse formats a description that contains %(prog), and then every % in it.
        description=doc.replace("%", "%%") if "%(prog)" in doc else doc,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    group = parser.add_argument_group("policy")
    parameters = []
    try:
        for parameter in inspect.signature(policy_class, eval_str=True).parameters.values():
            # Flags are not generated for *args and **kwargs.
            if parameter.kind not in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
                _add_flag(group, policy_class, parameter)
                parameters.append(parameter.name)
        if "execute" not in parameters:
            group.add_argument(
                "--execute",
                type=int,
                metavar="N",
                help="number of executed actions of every answer (default: the policy's own)",
            )
        add_server_flags(parser)
    except argparse.ArgumentError as error:
        raise UnusableParameter(
            f"a parameter of {policy_class.__name__} has the name of a server flag"
            f" ({error}); rename the parameter"
        ) from error
    return parser, parameters


def _add_flag(
    group: argparse._ArgumentGroup, policy_class: type[Policy], parameter: inspect.Parameter
) -> None:
    flag = "--" + parameter.name.replace("_", "-")
    kind = _type_of(parameter)
    if kind is None or parameter.kind is parameter.POSITIONAL_ONLY:
        raise UnusableParameter(
            f"no flag can be made for parameter {parameter} of {policy_class.__name__}: annotate"
            " it with bool, int, float, str, Path or one of them `| None`, or create the policy"
            " yourself and call serve"
        )
    required = parameter.default is parameter.empty
    default = None if required else parameter.default
    default_help = "" if required or default is None else f"default: {default}".replace("%", "%%")
    options: dict[str, Any] = {"dest": parameter.name, "required": required, "default": default}
    if kind is bool:
        # In some versions of Python, this action appends the default to the help itself, which
        # then shows the default twice.
        action = argparse.BooleanOptionalAction
        group.add_argument(flag, action=action, help=default_help, **options)
    else:
        help_ = default_help or ("required" if required else "default: none")
        group.add_argument(flag, type=kind, metavar=kind.__name__.upper(), help=help_, **options)


def _type_of(parameter: inspect.Parameter) -> type | None:
    """Returns the type of a parameter; None if a flag cannot have it."""
    annotation = parameter.annotation
    if annotation is parameter.empty:
        has_no_default = parameter.default is parameter.empty or parameter.default is None
        annotation = str if has_no_default else type(parameter.default)
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        kinds = [kind for kind in typing.get_args(annotation) if kind is not type(None)]
        annotation = kinds[0] if len(kinds) == 1 else None
    return annotation if annotation in FLAG_TYPES else None
