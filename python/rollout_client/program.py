"""The program `coordinator` on this machine. It computes results that need the protocol or
statistics: reports, comparisons, and the expansion of a specification."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Container
from pathlib import Path

from .access import Access
from .errors import ProgramError, RefusedError

NAME = "coordinator"


class Program:
    """The program `coordinator`: the given path, else the first on PATH at the time of a call."""

    def __init__(self, path: str | os.PathLike[str] | None, access: Access) -> None:
        self._given_path = path
        self._access = access

    def run(
        self, *arguments: str | Path, text: str | None = None, codes: Container[int] = (0,)
    ) -> str:
        """Runs the program with these arguments, and with `text` as its input. Returns its output.
        Raises ProgramError if the program is missing, and RefusedError, with the program's message,
        if it ends with another exit code than `codes`."""
        command = [self._path(), *map(str, arguments)]
        try:
            done = subprocess.run(command, input=text, capture_output=True, text=True)
        except OSError as error:
            raise ProgramError(
                f"failed to run {command[0]}: {error.strerror}; name the program in"
                " Client(program=…)"
            ) from error
        if done.returncode not in codes:
            message = done.stderr.strip().removeprefix("error: ")
            raise RefusedError(message or f"{' '.join(command)} ended with {done.returncode}")
        return done.stdout

    def with_connection(self, *arguments: str | Path) -> list[str | Path]:
        """Returns the arguments, followed by the flags that name this client's coordinator."""
        access = self._access
        flags: list[str | Path] = ["--connect", access.url]
        if access.token_file is not None:
            flags += ["--token-file", access.token_file]
        if access.ca is not None:
            flags += ["--ca", access.ca]
        return [*arguments, *flags]

    def _path(self) -> str:
        if self._given_path is not None:
            return str(Path(self._given_path).expanduser())
        path_on_system = shutil.which(NAME)
        if path_on_system is None:
            raise ProgramError(
                f"failed to find the program `{NAME}`, which computes reports and forecasts on"
                " this machine: build it (`cargo build --bin coordinator`) and put its folder on"
                " PATH, or name it in Client(program=…)"
            )
        return path_on_system
