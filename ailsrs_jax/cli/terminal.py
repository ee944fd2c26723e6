"""What a command prints: text for people, or with ``--json`` one object for programs."""

import contextlib
import dataclasses
import functools
import json
import shlex
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from tyro.conf import arg

from ailsrs_jax.cli.arguments import Flag

SECONDS_IN_A_LOG = 10.0  # between two lines of a stage where there is no terminal


@dataclasses.dataclass(frozen=True)
class Terminal:
    """The two options that every command has, and how it prints under them."""

    quiet: Flag = False
    """Print warnings and errors only."""
    as_json: Annotated[bool, arg(name="json", help_behavior_hint="")] = False
    """Print one JSON object on standard output, and all else on standard error."""

    @functools.cached_property
    def console(self) -> Console:
        """The console for people: on standard error if standard output is for a program."""
        return Console(stderr=self.as_json, quiet=self.quiet, highlight=False)

    def line(self, text: str) -> None:
        """Print a line for people, however long it is."""
        self.console.print(text, soft_wrap=True, markup=False)

    @contextlib.contextmanager
    def stage(self, name: str) -> Iterator[Callable[[int, int], None]]:
        """Show what goes on inside a ``with`` statement, and how long it has taken.

        The value is a function that can be told how many pictures are done, of how many. Where
        there is no terminal, a line shows it every ten seconds.
        """
        started, over = time.perf_counter(), threading.Event()
        in_a_log = not self.console.is_terminal
        columns = SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn()
        progress = Progress(*columns, console=self.console, transient=True, disable=in_a_log)
        task = progress.add_task(name, total=None)

        def show(done: int, total: int) -> None:
            progress.update(task, description=f"{name}: {done} of {total} pictures")

        def repeat() -> None:
            while not over.wait(SECONDS_IN_A_LOG):
                self.line(progress.tasks[0].description)

        if in_a_log:
            self.line(name)
            threading.Thread(target=repeat, name="progress", daemon=True).start()
        try:
            with progress:
                yield show
        finally:
            over.set()
        self.line(f"{name} took {time.perf_counter() - started:.1f} s")

    def json(self, fields: Mapping[str, Any]) -> None:
        """Print the object for programs if it was asked for; NaN and infinity become null."""
        if self.as_json:
            finite = json.loads(json.dumps(fields), parse_constant=lambda _: None)
            print(json.dumps(finite, indent=2))


# Added to the options of a command, without a prefix.
TerminalOptions = Annotated[Terminal, arg(name="")]
TERMINAL = Terminal()


def evaluation_fields(evaluation: Any) -> dict[str, Any]:
    """Return the JSON fields of an :class:`~ailsrs_jax.runs.evaluation.Evaluation`."""
    return {
        "episodes": len(evaluation.returns),
        "diverged": evaluation.num_diverged,
        "return_mean": evaluation.mean,
        "return_std": evaluation.std,
        "length_mean": float(evaluation.lengths.mean()),
    }


def this_command(*more: str) -> str:
    """Return the command line of this process followed by ``more``, quoted for a shell."""
    program = Path(sys.argv[0])
    start = [str(program)]
    if program.name == "__main__.py":
        start = [sys.executable, "-m", "ailsrs_jax"]
    elif program.exists() and (found := shutil.which(program.name)) and program.samefile(found):
        start = [program.name]
    return shlex.join([*start, *sys.argv[1:], *more])
