"""What the shards of a sweep have finished, put together."""

import shutil
from collections.abc import Sequence
from pathlib import Path

from ailsrs_jax.errors import UserError
from ailsrs_jax.sweeps.cells import load_sweep
from ailsrs_jax.sweeps.sweep import SWEEP_FILE, begun_stacks, is_done
from ailsrs_jax.sweeps.tables import TableRow, load_result, write_tables


def merge_sweeps(output: str | Path, sources: Sequence[str | Path]) -> list[TableRow]:
    """Copy what the shards ``sources`` of one sweep have finished, and write the tables of all.

    ``merge_sweeps("runs/paper", ["shards/0", "shards/1"])``, after two calls of :func:`sweep` with
    ``shard=(0, 2)`` and ``shard=(1, 2)``.

    Returns:
        The rows of ``results.csv``.

    Raises:
        UserError: they are not of the same sweep, or cannot be read or written; or ``output`` holds
            cells that are trained together and not finished.
    """
    if not sources:
        raise UserError("nothing to merge: give the directories of the shards")
    output, (first, *others) = Path(output), map(Path, sources)
    grid = load_sweep(first / SWEEP_FILE)
    for source in others:
        grid.require_same(source / SWEEP_FILE)
    grid.save(output / SWEEP_FILE)
    unfinished = {cell.name for cell in grid.cells if not is_done(output, cell)}
    for stack, begun in begun_stacks(output):
        if unfinished.intersection(begun):
            raise UserError(
                f"{stack} holds cells that are trained together: let them finish, or delete it to "
                "begin them anew, and then merge"
            )
    for source in (first, *others):
        for cell in grid.cells:
            name = Path("cells", cell.name)
            ended = load_result(source / name) is not None
            better = is_done(source, cell) and not is_done(output, cell)
            if better or (ended and not (output / name).exists()):  # else its progress may be lost
                _copy(source / name, output / name)
    return write_tables(output, grid.cells)


def _copy(source: Path, target: Path) -> None:
    """A directory, in place of another one, which is whole until it is replaced."""
    for path in source.rglob("*"):
        if path.is_symlink() or not (path.is_file() or path.is_dir()):
            raise UserError(f"{path} is no file: a run has left no such thing")
    try:
        temporary = target.with_name(f".{target.name}")
        shutil.rmtree(temporary, ignore_errors=True)
        shutil.copytree(source, temporary)
        shutil.rmtree(target, ignore_errors=True)
        temporary.rename(target)
    except OSError as error:
        raise UserError(f"cannot copy {source} to {target}: {error}") from error
