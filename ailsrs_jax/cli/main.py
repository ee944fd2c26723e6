"""The command line: ``ailsrs train | sweep | merge | evaluate | demonstrate | …``.

Commands import slow modules themselves, so that help and mistakes are answered at once.
"""

import importlib.metadata
import inspect
import logging
import os
import re
import sys
from collections.abc import Callable

import tyro

from ailsrs_jax.cli.experts import demonstrate, expert
from ailsrs_jax.cli.inspect import compare
from ailsrs_jax.cli.inspect import inspect as inspect_demonstrations
from ailsrs_jax.cli.measure import benchmark, evaluate
from ailsrs_jax.cli.show import export, render, report
from ailsrs_jax.cli.sweep import merge, sweep
from ailsrs_jax.cli.train import train
from ailsrs_jax.errors import UserError, did_you_mean
from ailsrs_jax.versions import VersionError

COMMANDS: dict[str, Callable[..., None]] = {
    "train": train,
    "demonstrate": demonstrate,
    "inspect": inspect_demonstrations,
    "compare": compare,
    "expert": expert,
    "evaluate": evaluate,
    "export": export,
    "render": render,
    "report": report,
    "sweep": sweep,
    "merge": merge,
    "benchmark": benchmark,
}

app = tyro.extras.SubcommandApp()
for name, command in COMMANDS.items():
    # Each argument's help on one line, because a terminal has its own width.
    command.__doc__ = re.sub(r"\n {8}(?=\S)", " ", inspect.cleandoc(command.__doc__ or ""))
    app.command(name=name)(command)


def main() -> None:
    """Run the command line; a user's mistake is one line on standard error and exit code 2."""
    logging.basicConfig(format="ailsrs: %(message)s")
    if os.environ.get("NO_COLOR"):  # https://no-color.org
        tyro._experimental_options["ansi_codes"] = False
    package = importlib.metadata.metadata("ailsrs_jax")
    arguments = sys.argv[1:] or ["--help"]
    if arguments == ["--version"]:
        print(f"ailsrs {package['Version']}")
        return
    try:
        name = arguments[0]
        if not name.startswith("-") and name not in COMMANDS:
            raise UserError(
                f"unknown command '{name}'{did_you_mean(name, COMMANDS)}: use one of "
                f"{', '.join(COMMANDS)}; see ailsrs --help"
            )
        app.cli(
            prog="ailsrs",
            description=package["Summary"],
            args=arguments,
            # Flags need no opposites, because every flag is off by default.
            config=(tyro.conf.FlagCreatePairsOff, tyro.conf.DisallowNone),
        )
    except KeyboardInterrupt:
        print("ailsrs: interrupted", file=sys.stderr)
        sys.exit(130)
    except (UserError, VersionError) as error:
        print(f"ailsrs: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(2)
