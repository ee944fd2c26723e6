"""What a command says, and where: with ``--json`` only that is on standard output."""

import inspect
import json
import math
import re
import shlex
import shutil
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from rich.console import Console

CommandT = TypeVar("CommandT", bound=Callable[..., None])


def make_console(*, quiet: bool, as_json: bool) -> Console:
    """For what people read: on standard error where standard output is for a program."""
    return Console(stderr=as_json, quiet=quiet, highlight=False)


def print_json(value: Mapping[str, Any]) -> None:
    """One object on standard output; what JSON has no number for is null."""
    sys.stdout.write(json.dumps(_finite(value), indent=2) + "\n")


def evaluation_fields(evaluation: Any) -> dict[str, Any]:
    """What ``--json`` says of an :class:`~ailsrs_jax.runs.evaluation.Evaluation`."""
    return {
        "episodes": len(evaluation.returns),
        "diverged": evaluation.num_diverged,
        "return_mean": evaluation.mean,
        "return_std": evaluation.std,
        "length_mean": float(evaluation.lengths.mean()),
    }


def this_command(*more: str) -> str:
    """The command line that this process was started with and ``more``, for a shell."""
    program = Path(sys.argv[0])
    if program.name == "__main__.py":
        start = [sys.executable, "-m", "ailsrs_jax"]
    else:
        found = shutil.which(program.name)
        is_found = found is not None and program.exists() and program.samefile(found)
        start = [program.name if is_found else str(program)]
    return shlex.join([*start, *sys.argv[1:], *more])


def as_command(function: CommandT) -> CommandT:
    """``function``, with each argument's help on a line: a terminal has its own width."""
    function.__doc__ = re.sub(r"\n {8}(?=\S)", " ", inspect.cleandoc(function.__doc__ or ""))
    return function


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
