"""The page of a run: the answer, then what it does, how it went, and what it has learned."""

import collections
import contextlib
from collections.abc import Mapping

import numpy as np

from ailsrs_jax.data.policies import SavedPolicy
from ailsrs_jax.envs.registry import TASKS, is_gymnasium
from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.evaluation import Evaluation, evaluation_episodes
from ailsrs_jax.runs.horizon import saved_horizon
from ailsrs_jax.runs.inspection.run import SeedInspection, inspect_run
from ailsrs_jax.runs.storage.metrics import percentage
from ailsrs_jax.runs.storage.saved_run import SavedRun
from ailsrs_jax.show.curves import by_seed
from ailsrs_jax.show.episodes.frames import Watch, unwatched
from ailsrs_jax.show.reports.charts import colors_of
from ailsrs_jax.show.reports.curves import draw_run, seed_name
from ailsrs_jax.show.reports.page import Media, Page, Part, Tile, millions, play, policies_of
from ailsrs_jax.show.reports.states import Met, differences, expert_reference, met_by, projection
from ailsrs_jax.show.reports.weights import weight_maps
from ailsrs_jax.show.sweep_report import Table, plus_minus
from ailsrs_jax.trainers.parts.reference import Reference

EPISODES = 100
MEASURES = {  # columns of metrics.csv in the table of seeds, and their titles
    "expert_distance": "energy distance",
    "validation_loss": "validation loss",
}


def run_page(
    run: SavedRun, *, episodes: int = EPISODES, video: bool = True, watch: Watch = unwatched
) -> Page:
    """Return the page of a run.

    Raises:
        UserError: a policy in its directory is damaged.
    """
    config, policies, expert = run.config, policies_of(run), expert_reference(run)
    evaluations, states, problem = _evaluate(run, policies, expert, episodes)
    inspections: dict[int, SeedInspection] = {}
    with contextlib.suppress(UserError):  # it has not measured its distance to the expert
        inspections = {each.seed: each for each in inspect_run(run)}
    # Small for a good seed.
    ranks = {seed: -evaluation.mean for seed, evaluation in evaluations.items()}
    ranks = ranks or {seed: inspection.distance for seed, inspection in inspections.items()}
    ranked = sorted(policies, key=lambda seed: np.fmin(ranks.get(seed, np.inf), np.inf))
    ends = dict(zip(ranked[:1] + (ranked[1:][-1:] if ranks else []), ("best", "worst")))
    colors = colors_of(map(seed_name, config["seeds"]))
    learns_from = "the environment's reward"
    if run.source is not None:
        learns_from = run.source.described(config["num_trajectories"], config["subsample"])
    parts: list[Part] = [
        _seed_table(run, evaluations, inspections, episodes, problem),
        _video(run, policies, ends, watch) if video else None,
        draw_run(run, colors),
    ]
    if ranked:
        best = f"policy of {seed_name(ranked[0])}"
        parts.append(weight_maps(best, policies[ranked[0]], expert))
    if expert is not None and states:
        met = {seed_name(seed): states[seed] for seed in ends}
        shown = {name: colors[name] for name in met}
        parts += projection(expert, met, shown), differences(met, shown)
    versions = dict(config["versions"])
    if config["demonstrations_sha256"] is not None:
        versions["demonstrations, SHA-256"] = config["demonstrations_sha256"]
    return Page(
        kind="run",
        title=f"{run.title} on {config['env_id']}",
        subtitle=f"{learns_from} · preset {config['preset']} · physics {config['physics']}",
        tiles=_tiles(run, evaluations, inspections),
        parts=parts,
        commands=[run.command or "Called from Python with objects that no command can name."],
        settings=config["settings"],
        changed=run.changed_settings(),
        versions=versions,
    )


def _evaluate(
    run: SavedRun,
    policies: Mapping[int, SavedPolicy],
    expert: Reference | None,
    episodes: int,
) -> tuple[dict[int, Evaluation], dict[int, Met], str]:
    """Return an evaluation of each seed, and the states it met if the expert's are known.

    There are none where a task is gone, and the last value says why.
    """
    env_id = run.config["env_id"]
    physics = "gymnasium" if env_id in TASKS or is_gymnasium(env_id) else "auto"
    evaluations, states = {}, {}
    try:
        length = saved_horizon(run.config, run.directory)
        for seed, policy in policies.items():
            simulated = evaluation_episodes(policy, episodes, physics, episode_length=length)
            evaluations[seed] = Evaluation.of(simulated)
            if expert is not None:
                states[seed] = met_by(simulated, expert)
    except UserError as error:
        return {}, {}, f"Not measured: {error}."
    return evaluations, states, ""


def _tiles(
    run: SavedRun,
    evaluations: Mapping[int, Evaluation],
    inspections: Mapping[int, SeedInspection],
) -> list[Tile]:
    returns = np.array([evaluation.mean for evaluation in evaluations.values()])
    expert = run.comparable_expert_return
    measured = len(returns) > 0 and np.isfinite(returns).all()
    share = percentage(returns.mean(), expert) if measured else ""
    verdicts = collections.Counter(each.verdict for each in inspections.values())
    judged = "; ".join(
        verdict if len(verdicts) == 1 else f"{number} of {verdicts.total()} seeds {verdict}"
        for verdict, number in verdicts.items()
    )
    over = f"mean of {len(returns)} seeds" if len(returns) > 1 else "one seed"
    tiles = []
    if share:
        answer = f"{share} of the expert"
        if len(returns) > 1:
            least, most = (percentage(end, expert) for end in (returns.min(), returns.max()))
            over += f", from {least} to {most}"
        tiles.append(Tile("return", plus_minus(returns), "of the kept policies"))
    elif len(returns):
        answer = f"return {plus_minus(returns)}"
    else:
        answer, judged, over = judged or "not measured", "", ""
    notes = [f"{judged}, by the energy distance" if judged else "", over]
    tiles.insert(0, Tile("kept policy", answer, " · ".join(filter(None, notes))))
    if run.expert_return is not None:
        mine, length = run.config["settings"].get("episode_length"), run.demonstrated_length
        note = "" if expert is not None else f", in episodes of {length} steps, not {mine}"
        tiles.append(
            Tile("expert", f"{run.expert_return:.0f}", f"return of the demonstrations{note}")
        )
    steps, iterations = (run.metrics[name].max() for name in ("env_steps", "iteration"))
    planned = run.config["settings"].get("num_iterations", "–")
    tiles.append(Tile("environment steps", millions(steps), "live steps of each seed, at most"))
    tiles.append(Tile("iterations", f"{iterations + 1:.0f}", f"of {planned}"))
    return tiles


def _seed_table(
    run: SavedRun,
    evaluations: Mapping[int, Evaluation],
    inspections: Mapping[int, SeedInspection],
    episodes: int,
    problem: str,
) -> Table:
    expert = run.comparable_expert_return
    measured = {name: title for name, title in MEASURES.items() if name in run.metrics}
    header = ["seed", "return", "of the expert", "verdict", "steps", "length", "kept at iteration"]
    rows = []
    for seed, mine in by_seed(run).items():
        kept, evaluation = run.kept_iterations.get(seed), evaluations.get(seed)
        at = np.flatnonzero(mine["iteration"] == kept)
        rows.append(
            [
                str(seed),
                str(evaluation or "–"),
                (percentage(evaluation.mean, expert) if evaluation else "") or "–",
                inspections[seed].verdict if seed in inspections else "–",
                millions(mine["env_steps"].max()),
                f"{evaluation.lengths.mean():.0f}" if evaluation else "–",
                "–" if kept is None else str(kept),
                *(f"{mine[name][at[0]]:.3f}" if len(at) else "–" for name in measured),
            ]
        )
    where = " in Gymnasium's own environment" if run.config["env_id"] in TASKS else ""
    notes = [
        "The return and the length are those of the kept policy: mean ± standard deviation over "
        f"{episodes} episodes{where}. Steps are live environment steps of training. {problem}",
        *(f"Seed {each.seed}: {why}." for each in inspections.values() for why in each.reasons),
    ]
    return Table("Seeds", [*header, *measured.values()], rows, "\n\n".join(notes))


def _video(
    run: SavedRun, policies: Mapping[int, SavedPolicy], ends: Mapping[int, str], watch: Watch
) -> Media:
    title = "What it does"
    if not policies:
        return Media(title, None, "No policy is saved yet.")
    shown = {
        f"{end}: {seed_name(seed)}" if len(ends) > 1 else seed_name(seed): policies[seed]
        for seed, end in ends.items()
    }
    which = "The policies of the best and the worst seed" if len(ends) > 1 else "The policy"
    return play(title, shown, [run], f"{which}, in real time", watch)
