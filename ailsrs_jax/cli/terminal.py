"""What a command prints: text for people, or with ``--json`` one object for programs."""

import dataclasses
import functools
import json
import math
import shlex
import shutil
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from rich.console import Console
from tyro.conf import arg


@dataclasses.dataclass(frozen=True)
class Terminal:
    """The two options that every command has, and how it prints under them."""

    quiet: Annotated[bool, arg(help="Print warnings and errors only.", help_behavior_hint="")] = (
        False
    )
    as_json: Annotated[
        bool,
        arg(
            name="json",
            help="Print one JSON object on standard output, and all else on standard error.",
            help_behavior_hint="",
        ),
    ] = False

    @functools.cached_property
    def console(self) -> Console:
        """The console for people: on standard error if standard output is for a program."""
        return Console(stderr=self.as_json, quiet=self.quiet, highlight=False)

    def line(self, text: str) -> None:
        """Print a line for people, however long it is."""
        self.console.print(text, soft_wrap=True, markup=False)

    def json(self, fields: Mapping[str, Any]) -> None:
        """Print the object for programs if it was asked for; NaN and infinity become null."""
        if self.as_json:
            sys.stdout.write(json.dumps(_finite(fields), indent=2) + "\n")


# Added to the options of a command, without a prefix.
TerminalOptions = Annotated[Terminal, arg(name="")]
TERMINAL = Terminal()


def evaluation_fields(evaluation: Any) -> dict[str, Any]:
    """The JSON fields of an :class:`~ailsrs_jax.runs.evaluation.Evaluation`."""
    return {
        "episodes": len(evaluation.returns),
        "diverged": evaluation.num_diverged,
        "return_mean": evaluation.mean,
        "return_std": evaluation.std,
        "length_mean": float(evaluation.lengths.mean()),
    }


def this_command(*more: str) -> str:
    """The command line of this process followed by ``more``, quoted for a shell."""
    program = Path(sys.argv[0])
    if program.name == "__main__.py":
        start = [sys.executable, "-m", "ailsrs_jax"]
    else:
        found = shutil.which(program.name)
        is_found = found is not None and program.exists() and program.samefile(found)
        start = [program.name if is_found else str(program)]
    return shlex.join([*start, *sys.argv[1:], *more])


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
