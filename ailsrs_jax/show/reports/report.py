"""``ailsrs report``: one self-contained HTML page on a run or a sweep."""

from pathlib import Path

from ailsrs_jax.errors import UserError, os_errors
from ailsrs_jax.files import require_writable, write_atomically
from ailsrs_jax.runs.storage.saved_run import read_run
from ailsrs_jax.show.episodes.frames import Watch, unwatched
from ailsrs_jax.show.reports.run_page import EPISODES, run_page
from ailsrs_jax.show.reports.sweep_page import sweep_page
from ailsrs_jax.sweeps.sweep import SWEEP_FILE


def report(
    directory: str | Path,
    output: str | Path | None = None,
    *,
    episodes: int = EPISODES,
    video: bool = True,
    watch: Watch = unwatched,
) -> Path:
    """Write one self-contained HTML page on a run or a sweep, finished or not.

    It begins with the answer. Tables, a video, curves, the settings and the command follow. Without
    a renderer, the page says in the video's place what to install.

    Args:
        directory: the directory of a run or of a sweep.
        output: the page; by default ``report.html`` in the directory.
        episodes: episodes of each policy of a run, to measure its return.
        video: show the policies, which takes the most time.
        watch: called with the number of pictures of a video that are drawn, and that of all.

    Returns:
        The path of the page.

    Raises:
        UserError: the directory holds neither a run nor a sweep, a file in it is damaged, or the
            page cannot be written.
    """
    directory, is_default = Path(directory), output is None
    output = directory / "report.html" if output is None else Path(output)
    if episodes < 1:
        raise UserError(f"episodes is {episodes}: it must be at least 1")
    is_run, is_sweep = (_holds(directory, name) for name in ("config.json", "results.csv"))
    if not (is_run or is_sweep):
        if _holds(directory, SWEEP_FILE):
            raise UserError(f"{directory}: no run of this sweep is finished yet")
        raise UserError(f"{directory} is neither a run nor a sweep: no config.json, no results.csv")
    # In a stranger's directory it could lead to any file of ours.
    if is_default and output.is_symlink():
        raise UserError(f"{output} is a link: choose an --output, or remove it")
    require_writable(output)
    if is_sweep:
        page = sweep_page(directory, video=video, watch=watch)
    else:
        page = run_page(read_run(directory), episodes=episodes, video=video, watch=watch)
    write_atomically(output, page.html())
    return output


def _holds(directory: Path, name: str) -> bool:
    with os_errors(f"cannot read {directory}"):
        return (directory / name).is_file()
