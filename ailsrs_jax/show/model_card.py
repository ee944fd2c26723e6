"""Model cards: what a policy is, how good, and how it was made, for whoever finds its files."""

import json
import re
from pathlib import Path
from typing import NamedTuple

from ailsrs_jax.data.policies import SavedLinearPolicy, SavedPolicy
from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.evaluation import Evaluation
from ailsrs_jax.runs.storage.saved_run import SavedRun, read_run

LICENSE = re.compile(r"[a-z0-9][a-z0-9.+-]{0,50}")  # as the Hugging Face Hub writes them


class Origin(NamedTuple):
    """The run that a policy is of, and its seed."""

    run: SavedRun
    seed: int


def find_origin(policy: SavedPolicy, path: Path) -> Origin | None:
    """The run that left the policy at ``path``; None if that is not in the directory of a run.

    Raises:
        UserError: the run's files are damaged, or of another task.
    """
    path = path.absolute()
    folder, directory = re.fullmatch(r"seed_(\d{1,10})", path.parent.name), path.parent.parent
    if folder is None or not (directory / "config.json").exists():
        return None
    run, seed = read_run(directory), int(folder[1])
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
    """Markdown with the header that the Hugging Face Hub reads.

    Args:
        policy: the policy.
        evaluation: its return.
        how_evaluated: the physics and seed, for people to read.
        origin: how it was made, if that is known.
        license_id: of the policy, an identifier of the Hub's.
    """
    algorithm = origin.run.title if origin else "A policy"
    title = f"{algorithm} on {policy.env_id}"
    kind = "linear" if isinstance(policy, SavedLinearPolicy) else "neural"
    sizes = f"{len(policy.mean)} observations, {len(policy.action_low)} actions"
    result = f"{evaluation} over {len(evaluation.returns)} episodes ({how_evaluated})"
    rows = {"task": policy.env_id, "policy": f"{kind}, {sizes}", "return": result}
    made = "It was exported from a file that does not say how the policy was trained."
    if origin is not None:
        config, command = origin.run.config, origin.run.command
        rows |= {
            "algorithm": f"{algorithm}, preset {config['preset']}",
            "seed": str(origin.seed),
            "demonstrations": _demonstrations(origin.run),
            "physics of the training": config["physics"],
            "versions": ", ".join(f"{name} {value}" for name, value in config["versions"].items()),
        }
        made = "The environment or the demonstrations were handed in from Python."
        if command is not None:
            made = f"```sh\n{_printable(command)}\n```"
    table = "\n".join(f"| {name} | {_cell(value)} |" for name, value in rows.items())
    parts = [
        f"---\n{_header(policy, evaluation, title, origin, license_id)}---",
        f"# {_cell(title)}",
        f"| | |\n|---|---|\n{table}",
        "## How it was made",
        made,
        "## Use",
        "All files hold the same policy. In NumPy alone:",
        f"```python\n{_NUMPY_LINEAR if kind == 'linear' else _NUMPY_NEURAL}```",
        "`policy.onnx` takes `observation`, float32 `(batch, n)`, and gives `action`, float32 "
        "`(batch, p)`, standardisation and clipping included:",
        f"```python\n{_ONNX}```",
        "`policy.safetensors` holds the same arrays as `policy.npz`; both are read by "
        "`ailsrs_jax.load_policy`:",
        f"```python\n{_OURS}```",
    ]
    return "\n\n".join(parts) + "\n"


def _header(
    policy: SavedPolicy,
    evaluation: Evaluation,
    title: str,
    origin: Origin | None,
    license_id: str,
) -> str:
    """YAML, in which every JSON text is a text."""
    tags = ["reinforcement-learning", policy.env_id]
    if origin is not None and origin.run.imitates:
        tags.insert(0, "imitation-learning")
    quoted = {name: json.dumps(name, ensure_ascii=False) for name in (*tags, title)}
    lines = [
        "library_name: ailsrs_jax",
        f"license: {license_id}",
        "pipeline_tag: reinforcement-learning",
        "tags:",
        *(f"- {quoted[tag]}" for tag in tags),
        "model-index:",
        f"- name: {quoted[title]}",
        "  results:",
        "  - task:",
        "      type: reinforcement-learning",
        "      name: reinforcement-learning",
        "    dataset:",
        f"      type: {quoted[policy.env_id]}",
        f"      name: {quoted[policy.env_id]}",
        "    metrics:",
        "    - type: mean_reward",
        "      name: mean_reward",
        f"      value: {evaluation.mean:.2f} +/- {evaluation.std:.2f}",
        "      verified: false",
    ]
    return "".join(f"{line}\n" for line in lines)


def _demonstrations(run: SavedRun) -> str:
    config, source, every = run.config, run.source, run.config["subsample"]
    if source is None:
        return "none: it learnt from the environment's reward"
    described = str(source) if source.kind in ("expert", "memory") else f"of {source}"
    steps = f", every {every}th step" if every not in (None, 1) else ""
    sha256 = config["demonstrations_sha256"]
    return f"{config['num_trajectories']} {described}{steps}; SHA-256 {sha256}"


def _cell(text: str) -> str:
    """In a table, and not as Markdown or HTML, whatever it is."""
    return re.sub(r"([\\`*_{}\[\]<>|#])", r"\\\1", _printable(text))


def _printable(text: str) -> str:
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


_NUMPY_LINEAR = """\
import numpy as np

policy = np.load("policy.npz")
observation = np.zeros(len(policy["mean"]))
action = policy["weights"] @ ((observation - policy["mean"]) / policy["std"])
action = np.clip(action, policy["action_low"], policy["action_high"])
"""
_NUMPY_NEURAL = """\
import numpy as np

policy = np.load("policy.npz")
observation = np.zeros(len(policy["mean"]))
action = (observation - policy["mean"]) / policy["std"]
for layer in range(sum(name.startswith("weights_") for name in policy)):
    action = np.tanh(action) if layer else action
    action = policy[f"weights_{layer}"] @ action + policy[f"biases_{layer}"]
action = np.clip(action, policy["action_low"], policy["action_high"])
"""
_ONNX = """\
import onnxruntime

session = onnxruntime.InferenceSession("policy.onnx")
batch = observation[None].astype("float32")
(actions,) = session.run(["action"], {"observation": batch})
"""
_OURS = """\
import ailsrs_jax as ail

policy = ail.load_policy("policy.safetensors")
action = policy(observation)
"""
