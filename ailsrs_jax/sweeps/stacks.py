"""Stacks: cells of a sweep that are trained as one program and share a checkpoint until the end."""

import contextlib
import hashlib
from collections.abc import Sequence
from pathlib import Path

from ailsrs_jax.files import read_json_if_there, write_json
from ailsrs_jax.sweeps.cells import Cell

STACK_FILE = "cells.json"  # in the directory of an unfinished stack
CHECKPOINTS = "checkpoints/*"  # of a stack or a cell


def stack_directory(output: Path, unit: Sequence[Cell]) -> Path:
    """Return the directory of the shared checkpoint of cells that are trained together."""
    names = "".join(cell.name for cell in unit)
    return output / "stacks" / hashlib.sha256(names.encode()).hexdigest()[:16]


def begun_stacks(output: Path, names: set[str]) -> list[Path]:
    """Return the directories of the unfinished stacks that have any of the cells ``names``."""
    return [path for path in (output / "stacks").glob("*") if names.intersection(_members(path))]


def _members(stack: Path) -> list[str]:
    """Return the names of the cells of a stack; none before its first checkpoint.

    Another process may remove the stack meanwhile, because all its cells are finished.

    Raises:
        UserError: the file is damaged.
    """
    content = None
    with contextlib.suppress(FileNotFoundError):
        if any(stack.glob(CHECKPOINTS)):
            what = "the list of a stack; delete its directory"
            content = read_json_if_there(stack / STACK_FILE, what)
    names = (content or {}).get("cells")
    return [name for name in names if isinstance(name, str)] if isinstance(names, list) else []


def split_unit(unit: Sequence[Cell], unfinished: Sequence[Cell], output: Path) -> list[list[Cell]]:
    """Split the unfinished cells of a unit into groups that are trained together.

    The cells of an unfinished stack stay together, including those that are finished. Otherwise a
    cell with a checkpoint of its own is trained alone, and the others are a new stack.
    """
    stack = stack_directory(output, unit)
    members = _members(stack)
    if members:
        together = [cell for cell in unit if cell.name in members]
    else:
        together = [
            cell for cell in unfinished if not any((output / "cells" / cell.name).glob(CHECKPOINTS))
        ]
        if len(together) > 1:
            write_json(stack / STACK_FILE, {"cells": [cell.name for cell in together]})
    alone = [[cell] for cell in unfinished if cell not in together]
    return [*alone, together] if together else alone
