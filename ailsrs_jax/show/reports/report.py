"""``ailsrs report``: one self-contained HTML page on a run or a sweep."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ailsrs_jax.data.policies import SavedPolicy
from ailsrs_jax.envs.registry import TASKS, is_gymnasium
from ailsrs_jax.errors import UserError
from ailsrs_jax.files import require_writable, write_atomically
from ailsrs_jax.runs.evaluation import Evaluation, evaluate
from ailsrs_jax.runs.horizon import saved_horizon
from ailsrs_jax.runs.storage.saved_run import SavedRun, read_run
from ailsrs_jax.show.curves import by_seed, draw_curves
from ailsrs_jax.show.reports.page import (
    SCORES,
    Media,
    Page,
    Tile,
    embedded,
    millions,
    play,
    policies_of,
)
from ailsrs_jax.show.reports.sweep_page import sweep_page
from ailsrs_jax.show.sweep_report import Table, plus_minus
from ailsrs_jax.show.video import shipped_expert
from ailsrs_jax.sweeps.sweep import SWEEP_FILE

EPISODES = 100
MEASURES = {  # columns of metrics.csv in the table of seeds, and their titles
    "expert_distance": "energy distance",
    "validation_loss": "validation loss",
    "policy_score": "policy's score",
    "expert_score": "expert's score",
}


def report(
    directory: str | Path,
    output: str | Path | None = None,
    *,
    episodes: int = EPISODES,
    video: bool = True,
) -> Path:
    """Write one self-contained HTML page on a run or a sweep, finished or not.

    It shows settings, curves, tables, a video, the command and the versions of libraries. Without a
    renderer, the page says in the video's place what to install.

    Args:
        directory: the directory of a run or of a sweep.
        output: the page; by default ``report.html`` in the directory.
        episodes: episodes of each policy of a run, to measure its return.
        video: show the policies, which takes the most time.

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
        page = sweep_page(directory, video=video)
    else:
        page = run_page(read_run(directory), episodes=episodes, video=video)
    write_atomically(output, page.html())
    return output


def _holds(directory: Path, name: str) -> bool:
    try:
        return (directory / name).is_file()
    except OSError as error:
        raise UserError(f"cannot read {directory}: {error.strerror}") from error


def run_page(run: SavedRun, *, episodes: int = EPISODES, video: bool = True) -> Page:
    """Return the page of a run.

    Raises:
        UserError: a policy in its directory is damaged.
    """
    config = run.config
    policies = policies_of(run)
    evaluations, problem = _evaluate(run, policies, episodes)
    learns_from = "the environment's reward"
    if run.imitates:
        learns_from = f"{config['num_trajectories']} demonstrations {run.source}"
    where = " in Gymnasium's own environment" if config["env_id"] in TASKS else ""
    changed = run.changed_settings()
    versions = dict(config["versions"])
    if config["demonstrations_sha256"] is not None:
        versions["demonstrations, SHA-256"] = config["demonstrations_sha256"]
    caption = f"A dot marks the iteration whose policy is kept. {SCORES}"
    return Page(
        kind="run",
        title=f"{run.title} on {config['env_id']}",
        subtitle=f"{learns_from} · preset {config['preset']} · physics {config['physics']}",
        tiles=_tiles(run, evaluations),
        videos=[_video(run, policies)] if video else [],
        figures=[Media("Training", embedded(draw_curves(run), "svg"), caption)],
        tables=[_seed_table(run, evaluations)],
        note="The return is that of the kept policy: mean ± standard deviation over "
        f"{episodes} episodes{where}. {problem}",
        commands=[run.command or "Called from Python with objects that no command can name."],
        settings=[
            (name, str(value), name in changed) for name, value in config["settings"].items()
        ],
        versions=[(name, str(version)) for name, version in versions.items()],
    )


def _evaluate(
    run: SavedRun, policies: Mapping[int, SavedPolicy], episodes: int
) -> tuple[dict[int, Evaluation], str]:
    """Return an evaluation for each seed, or none and the reason, such as a task that is gone."""
    env_id = run.config["env_id"]
    physics = "gymnasium" if env_id in TASKS or is_gymnasium(env_id) else "auto"
    try:
        length = saved_horizon(run.config, run.directory)
        return {
            seed: evaluate(policy, episodes, physics, episode_length=length)
            for seed, policy in policies.items()
        }, ""
    except UserError as error:
        return {}, f"Not measured: {error}."


def _tiles(run: SavedRun, evaluations: Mapping[int, Evaluation]) -> list[Tile]:
    returns = np.array([evaluation.mean for evaluation in evaluations.values()])
    expert = run.expert_return
    tiles = []
    if len(returns):
        over = f"mean ± std over {len(returns)} seeds" if len(returns) > 1 else "of one seed"
        tiles.append(Tile("return", plus_minus(returns), over))
    if expert is not None:
        mine, length = run.config["settings"].get("episode_length"), run.demonstrated_length
        comparable = length is None or length == mine
        note = "" if comparable else f", in episodes of {length} steps, not {mine}"
        tiles.append(Tile("expert", f"{expert:.0f}", f"return of the demonstrations{note}"))
        if len(returns) and expert > 0 and comparable:
            tiles.append(Tile("of the expert's", f"{returns.mean() / expert:.0%}", "return"))
    steps, iterations = (run.metrics[name].max() for name in ("env_steps", "iteration"))
    planned = run.config["settings"].get("num_iterations", "–")
    tiles.append(Tile("environment steps", millions(steps), "live steps of each seed"))
    tiles.append(Tile("iterations", f"{iterations + 1:.0f}", f"of {planned}"))
    return tiles


def _seed_table(run: SavedRun, evaluations: Mapping[int, Evaluation]) -> Table:
    shown = {name: title for name, title in MEASURES.items() if name in run.metrics}
    header = ["seed", "return", "length", "kept at iteration", *shown.values(), "last evaluation"]
    rows = []
    for seed, mine in by_seed(run.metrics).items():
        kept, evaluation = run.kept_iterations.get(seed), evaluations.get(seed)
        at = np.flatnonzero(mine["iteration"] == kept)
        rows.append(
            [
                str(seed),
                str(evaluation or "–"),
                f"{evaluation.lengths.mean():.0f}" if evaluation else "–",
                "–" if kept is None else str(kept),
                *(f"{mine[name][at[0]]:.3f}" if len(at) else "–" for name in shown),
                f"{mine['evaluation_return'][-1]:.0f}",
            ]
        )
    return Table("Seeds", header, rows)


def _video(run: SavedRun, policies: Mapping[int, SavedPolicy]) -> Media:
    title = "What it does"
    if not policies:
        return Media(title, None, "No policy is saved yet.")
    seed, policy = next(iter(policies.items()))
    expert = shipped_expert(run.config["env_id"], run.source)
    caption = f"The policy of seed {seed}, in real time"
    return play(title, {"policy": policy}, expert, caption, run)
