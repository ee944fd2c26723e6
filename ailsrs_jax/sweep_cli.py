"""The commands for many runs: ``ailsrs sweep``."""

import sys
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from tyro.conf import Positional

console = Console()


def sweep(spec: Positional[Path], output: Path | None = None) -> None:
    """Train every cell of a declarative grid: algorithms, tasks, demonstrations, settings, seeds.

    The same command goes on where it was stopped.

    Example: ailsrs sweep experiments/smoke.toml

    Args:
        spec: A TOML file; docs/sweeps.md says what it holds.
        output: The directory of the sweep; by default runs/NAME, of a file NAME.toml.
    """
    from ailsrs_jax.progress import SweepProgress
    from ailsrs_jax.runs import sweep as sweeps
    from ailsrs_jax.runs.sweep_spec import expand, read_spec
    from ailsrs_jax.runs.sweep_tables import DONE

    grid = expand(read_spec(spec))
    output = output or Path("runs") / spec.stem
    grid.save(output / sweeps.SWEEP_FILE)
    cells = sweeps.pending(grid.cells, output)
    console.print(
        f"[bold]{escape(str(spec))}[/] · {len(grid.cells)} cells, {len(cells)} of them to train · "
        f"{escape(str(output))}",
        highlight=False,
        soft_wrap=True,
    )
    try:
        with SweepProgress(console, cells, len(grid.cells) - len(cells)) as watch:
            rows = sweeps.run_cells(grid, cells, output, watch)
    except KeyboardInterrupt:
        console.print("interrupted; the same command goes on")
        sys.exit(130)
    failed = [row for row in rows if row["status"] != DONE]
    for row in failed:
        console.print(f"{row['cell']} {row['status']}", style="red", markup=False, soft_wrap=True)
    console.print(f"results.csv, curves.csv and timings.csv are in {escape(str(output))}")
    if failed:
        console.print(f"{len(failed)} cells have failed; the same command tries them again")
        sys.exit(1)
