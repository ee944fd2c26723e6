"""Merge the directories of a sweep's shards."""

import shutil
from collections.abc import Sequence
from pathlib import Path

from ailsrs_jax.errors import UserError, os_errors
from ailsrs_jax.runs.storage.directory import locked
from ailsrs_jax.sweeps.cells import load_sweep
from ailsrs_jax.sweeps.stacks import begun_stacks
from ailsrs_jax.sweeps.sweep import SWEEP_FILE
from ailsrs_jax.sweeps.tables import TableRow, load_row, write_tables
from ailsrs_jax.sweeps.unit import is_done


def merge_sweeps(output: str | Path, sources: Sequence[str | Path]) -> list[TableRow]:
    """Copy the finished cells of the shards ``sources`` to ``output``, and write the tables.

    After two calls of :func:`sweep` with ``shard=(0, 2)`` and ``shard=(1, 2)``, call
    ``merge_sweeps("runs/paper", ["shards/0", "shards/1"])``.

    Returns:
        The rows of ``results.csv``.

    Raises:
        UserError: the shards are not of the same sweep, or cannot be read or copied; or ``output``
            holds an unfinished stack, or another process trains a cell there.
    """
    if not sources:
        raise UserError("there is nothing to merge: name the directories of the shards")
    output, (first, *others) = Path(output), map(Path, sources)
    grid = load_sweep(first / SWEEP_FILE)
    for source in others:
        grid.require_same(source / SWEEP_FILE)
    grid.save(output / SWEEP_FILE)
    unfinished = {cell.name for cell in grid.cells if not is_done(output, cell)}
    for stack in begun_stacks(output, unfinished):
        raise UserError(
            f"{stack} holds cells that are trained together: let them finish, or delete it to "
            "train them anew, and then merge"
        )
    for source in (first, *others):
        for cell in grid.cells:
            name = Path("cells", cell.name)
            better = is_done(source, cell) and not is_done(output, cell)
            # A failed cell is copied only where it cannot replace the progress of a run.
            if better or (load_row(source / name)[0] and not (output / name).exists()):
                _copy(source / name, output / name)
    return write_tables(output, grid.cells)


def _copy(source: Path, target: Path) -> None:
    """Replace the directory ``target`` by a copy of ``source``, once the copy is complete.

    Raises:
        UserError: another process writes to ``target``, or ``source`` cannot be copied.
    """
    for path in source.rglob("*"):
        if path.is_symlink() or not (path.is_file() or path.is_dir()):
            raise UserError(f"{path} is neither a file nor a directory: a run did not write it")
    with os_errors(f"cannot copy {source} to {target}"), locked(target):
        temporary = target.with_name(f".{target.name}")
        shutil.rmtree(temporary, ignore_errors=True)
        shutil.copytree(source, temporary)
        shutil.rmtree(target, ignore_errors=True)
        temporary.rename(target)
