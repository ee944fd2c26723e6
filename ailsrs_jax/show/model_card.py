"""Model cards: what a policy is, how good it is, and how it was made."""

import re
from pathlib import Path
from typing import NamedTuple

from ailsrs_jax.data.policies import SavedLinearPolicy, SavedPolicy
from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.evaluation import Evaluation
from ailsrs_jax.runs.storage.config import find_run
from ailsrs_jax.runs.storage.saved_run import SavedRun, read_run

LICENSE = re.compile(r"[a-z0-9][a-z0-9.+-]{0,50}")  # the identifiers of the Hugging Face Hub
TEMPLATE = Path(__file__).with_name("model_card.md")


class Origin(NamedTuple):
    """The run and the seed that a policy comes from."""

    run: SavedRun
    seed: int


def find_origin(policy: SavedPolicy, path: Path) -> Origin | None:
    """Return the run that wrote the policy at ``path``, or None if ``path`` is not in a run.

    Raises:
        UserError: the run's files are damaged, or belong to another task.
    """
    if (found := find_run(path)) is None:
        return None
    directory, seed = found
    run = read_run(directory)
    if run.config["env_id"] != policy.env_id or seed not in run.config["seeds"]:
        raise UserError(
            f"{directory} is a run of {run.config['env_id']} with the seeds {run.config['seeds']}: "
            f"{path} is of {policy.env_id} and seed {seed}"
        )
    return Origin(run.without_folder(), seed)


def require_license(name: str) -> None:
    """Raise UserError unless ``name`` can be the identifier of a licence."""
    if not LICENSE.fullmatch(name):
        raise UserError(f"'{name}' names no licence: write an identifier such as apache-2.0 or mit")


def model_card(
    policy: SavedPolicy,
    evaluation: Evaluation,
    how_evaluated: str,
    origin: Origin | None,
    license_id: str,
) -> str:
    """Return the card as Markdown, with the metadata that the Hugging Face Hub reads.

    ``how_evaluated`` tells people the physics and the seed of ``evaluation``.
    """
    from huggingface_hub import EvalResult, ModelCard, ModelCardData

    algorithm = origin.run.title if origin else "A policy"
    title = f"{algorithm} on {policy.env_id}"
    kind = "linear" if isinstance(policy, SavedLinearPolicy) else "neural"
    facts = {
        "task": policy.env_id,
        "policy": f"{kind}, {len(policy.mean)} observations, {len(policy.action_low)} actions",
        "return": f"{evaluation} over {len(evaluation.returns)} episodes ({how_evaluated})",
    }
    tags, command = ["reinforcement-learning", policy.env_id], None
    if origin is not None:
        config, command = origin.run.config, origin.run.command
        facts |= {
            "algorithm": f"{algorithm}, preset {config['preset']}",
            "seed": str(origin.seed),
            "demonstrations": _demonstrations(origin.run),
            "physics of the training": config["physics"],
            "versions": ", ".join(f"{name} {value}" for name, value in config["versions"].items()),
        }
        if origin.run.imitates:
            tags.insert(0, "imitation-learning")
    result = EvalResult(
        task_type="reinforcement-learning",
        task_name="reinforcement-learning",
        dataset_type=policy.env_id,
        dataset_name=policy.env_id,
        metric_type="mean_reward",
        metric_name="mean_reward",
        metric_value=f"{evaluation.mean:.2f} +/- {evaluation.std:.2f}",
        verified=False,
    )
    metadata = ModelCardData(
        library_name="ailsrs_jax",
        license=license_id,
        pipeline_tag="reinforcement-learning",
        tags=tags,
        model_name=title,
        eval_results=[result],
    )
    card = ModelCard.from_template(
        metadata,
        template_path=str(TEMPLATE),
        title=escape_markdown(title),
        facts={name: escape_markdown(value) for name, value in facts.items()},
        command=command and _printable(command),
        origin=origin,
        kind=kind,
    )
    return str(card)


def _demonstrations(run: SavedRun) -> str:
    source, every = run.source, run.config["subsample"]
    if source is None:
        return "none: it learnt from the environment's reward"
    described = str(source) if source.kind in ("expert", "memory") else f"of {source}"
    steps = f", one step in {every}" if every != 1 else ""
    sha256 = run.config["demonstrations_sha256"]
    return f"{run.config['num_trajectories']} {described}{steps}; SHA-256 {sha256}"


def escape_markdown(text: str) -> str:
    """Escape what Markdown or HTML would interpret, also within a table."""
    # Underscores within a word and brackets without an address behind them are only text.
    return re.sub(r"[\\`*<>|#~$]|(?<!\w)_|_(?!\w)|\](?=\()", r"\\\g<0>", _printable(text))


def _printable(text: str) -> str:
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)
