"""The page of a run on which its policies run in the browser."""

from pathlib import Path

from ailsrs_jax.data.policies import SavedPolicy, load_policy, policy_files
from ailsrs_jax.errors import UserError
from ailsrs_jax.files import require_writable, write_atomically
from ailsrs_jax.runs.horizon import policy_horizon
from ailsrs_jax.runs.storage.metrics import percentage
from ailsrs_jax.runs.storage.policies import EVALUATED
from ailsrs_jax.runs.storage.saved_run import read_run
from ailsrs_jax.show.episodes.play import play_html, require_playable
from ailsrs_jax.show.learning import stored_policies
from ailsrs_jax.show.video import PolicyOrPath, find_expert


def write_play(
    policy: Path,
    output: Path,
    *,
    expert: PolicyOrPath | None = None,
    alone: bool = False,
    seed: int = 0,
) -> list[str]:
    """Write a page that runs a policy, and the earlier ones of its run, in the browser.

    Args:
        policy: a policy file, or a run directory, whose first seed is shown.
        output: an ``.html`` file.
        expert: the expert or its file; by default the shipped expert of the task, if there is one.
        alone: leave the expert out.
        seed: of the initial states.

    Returns:
        What the page calls the policies.

    Raises:
        UserError: an argument is wrong, the page does not know the task, a file is damaged, or npm
            cannot fetch MuJoCo's WebAssembly build.
    """
    if output.suffix != ".html":
        raise UserError(f"{output}: --play writes a page, whose name ends in .html")
    require_writable(output)
    file = policy_files(policy)[0].absolute()
    kept = load_policy(file)
    require_playable(kept.env_id)
    policies, title = _of_run(file, kept)
    if not alone and (shown := find_expert(policy, kept, expert)) is not None:
        policies["expert"] = shown
    html = play_html(policies, title=title, seed=seed, episode_length=policy_horizon(file))
    write_atomically(output, html)
    return list(policies)


def _of_run(file: Path, kept: SavedPolicy) -> tuple[dict[str, SavedPolicy], str]:
    """Return the policies of the seed that has kept the policy ``file``, and a title."""
    if not (file.parent / EVALUATED).is_dir():
        return {"policy": kept}, "A policy in your browser"
    run = read_run(file.parent.parent)
    files, returns = stored_policies(run, file.parent)
    policies: dict[str, SavedPolicy] = {}
    for iteration, path in reversed(files.items()):  # the kept one comes first
        what = f"iteration {iteration}"
        if not policies:
            what = "kept policy"
        elif iteration == 0 and run.config["settings"].get("behavior_cloning_start"):
            what = "clone of the expert"
        each = load_policy(path)
        if each.env_id != kept.env_id:
            raise UserError(f"{path} is of {each.env_id}, not of the run's task")
        share = percentage(returns[iteration], run.expert_return)
        result = f"{share} of the expert" if share else f"return {returns[iteration]:.0f}"
        policies[f"{what}: {result}"] = each
    return policies, f"{run.title}, the policies of a run"
