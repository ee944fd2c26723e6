"""Model cards: what a policy is, how good, and how it was made, for whoever finds its files."""

import dataclasses
import json
import re
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ailsrs_jax.data.policies import SavedLinearPolicy, SavedPolicy
from ailsrs_jax.envs.registry import TASKS, short_name
from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.algorithms import find_algorithm
from ailsrs_jax.runs.config import read_config
from ailsrs_jax.runs.evaluation import Evaluation
from ailsrs_jax.runs.presets import preset_settings
from ailsrs_jax.runs.training_data import HANDED_IN, PAPER_EXPERT, SHIPPED_EXPERT

LICENSE = re.compile(r"[a-z0-9][a-z0-9.+-]{0,50}")  # as the Hugging Face Hub writes them
LONGEST = 300  # characters of a text from a run's configuration

# What a card needs of config.json; the settings and versions are maps of numbers and text.
FIELDS: dict[str, tuple[type, ...]] = {
    "env_id": (str,),
    "physics": (str,),
    "seeds": (list,),
    "algorithm": (str,),
    "preset": (str,),
    "settings": (dict,),
    "num_trajectories": (int, type(None)),
    "demonstrations": (str, type(None)),
    "demonstrations_sha256": (str, type(None)),
    "subsample": (int, type(None)),
    "versions": (dict,),
}


@dataclasses.dataclass(frozen=True)
class Provenance:
    """How the policy of one seed of a run was made: what its ``config.json`` says."""

    config: Mapping[str, Any]
    seed: int

    @property
    def algorithm(self) -> str:
        """For people to read."""
        return find_algorithm(self.config["algorithm"]).title

    @property
    def demonstrations(self) -> str:
        """For people to read: how many, where they are from, and their hash."""
        config = self.config
        if config["num_trajectories"] is None:
            return "none: it learnt from the environment's reward"
        source = config["demonstrations"]
        if source not in (SHIPPED_EXPERT, HANDED_IN):
            source = f"of {_without_folder(source)}"
        every = f", every {config['subsample']}th step" if config["subsample"] > 1 else ""
        sha256 = config["demonstrations_sha256"]
        return f"{config['num_trajectories']} {source}{every}; SHA-256 {sha256}"

    @property
    def command(self) -> str | None:
        """The command that makes the run again; None of what was handed in from Python."""
        config = self.config
        env_id, source = config["env_id"], config["demonstrations"]
        if (env_id not in TASKS and ":" not in env_id) or source == HANDED_IN:
            return None
        words = ["ailsrs", "train", short_name(env_id), "--algorithm", config["algorithm"]]
        if source not in (None, SHIPPED_EXPERT):
            # A note of what the reader left out follows the name.
            name = re.sub(r" \(\d+ cut off, left out\)$", "", source)
            words += ["--demonstrations", _without_folder(name)]
        if config["num_trajectories"] is not None:
            words += ["--num-trajectories", config["num_trajectories"]]
            words += ["--subsample", config["subsample"]]
        words += ["--seeds", *config["seeds"], "--preset", config["preset"]]
        if env_id in TASKS:  # one's own task may have no engine to choose
            words += ["--physics", config["physics"]]
        preset = vars(preset_settings(env_id, config["preset"], config["algorithm"]))
        changed = {k: v for k, v in config["settings"].items() if preset.get(k) != v}
        if changed:
            words += ["--set", *(f"{name}={value}" for name, value in changed.items())]
        return shlex.join(map(str, words))


def read_provenance(policy: SavedPolicy, path: Path) -> Provenance | None:
    """How the policy in the file ``path`` was made; None if that is not of a run directory.

    Raises:
        UserError: the run's ``config.json`` is damaged, or of another task.
    """
    folder = re.fullmatch(r"seed_(\d{1,10})", path.absolute().parent.name)
    config_path = path.absolute().parent.parent / "config.json"
    if folder is None or not config_path.exists():
        return None
    config = read_config(config_path)

    def require(condition: bool, problem: str) -> None:
        if not condition:
            raise UserError(f"{config_path} is not the configuration of this run: {problem}")

    for name, kinds in FIELDS.items():
        value = config.get(name)
        require(type(value) in kinds and name in config, f"it has no {name} that makes sense")
        texts = [value] if isinstance(value, str) else []
        if isinstance(value, dict):
            scalars = (str, int, float, bool)
            require(all(type(x) in scalars for x in value.values()), f"{name} holds something odd")
            texts = [text for item in value.items() for text in item if isinstance(text, str)]
        for text in texts:
            readable = text.isprintable() and len(text) <= LONGEST
            require(readable, f"{name} holds what nobody can read")
    seed = int(folder[1])
    require(config["env_id"] == policy.env_id, f"the policy is of {policy.env_id}")
    require(all(type(x) is int for x in config["seeds"]), "its seeds are not numbers")
    require(seed in config["seeds"], f"it has no seed {seed}")
    of_demonstrations = [config[name] is None for name in FIELDS if FIELDS[name][1:]]
    imitates = find_algorithm(config["algorithm"]).imitates
    require(set(of_demonstrations) == {not imitates}, "it tells of demonstrations but in part")
    preset_settings(config["env_id"], config["preset"], config["algorithm"])
    return Provenance(config, seed)


def require_license(name: str) -> None:
    """Raise UserError unless ``name`` can be the identifier of a licence."""
    if not LICENSE.fullmatch(name):
        raise UserError(f"'{name}' names no licence: write an identifier such as apache-2.0 or mit")


def model_card(
    policy: SavedPolicy,
    evaluation: Evaluation,
    how_evaluated: str,
    provenance: Provenance | None,
    license_id: str,
) -> str:
    """Markdown with the header that the Hugging Face Hub reads.

    Args:
        policy: the policy.
        evaluation: its return.
        how_evaluated: the physics and seed, for people to read.
        provenance: how it was made, if that is known.
        license_id: of the policy, an identifier of the Hub's.
    """
    title = f"{provenance.algorithm if provenance else 'A policy'} on {policy.env_id}"
    kind = "linear" if isinstance(policy, SavedLinearPolicy) else "neural"
    sizes = f"{len(policy.mean)} observations, {len(policy.action_low)} actions"
    result = f"{evaluation} over {len(evaluation.returns)} episodes ({how_evaluated})"
    rows = {"task": policy.env_id, "policy": f"{kind}, {sizes}", "return": result}
    if provenance is None:
        made = "It was exported from a file that does not say how the policy was trained."
    else:
        config = provenance.config
        rows |= {
            "algorithm": f"{provenance.algorithm}, preset {config['preset']}",
            "seed": f"{provenance.seed}",
            "demonstrations": provenance.demonstrations,
            "physics of the training": config["physics"],
            "versions": ", ".join(f"{name} {value}" for name, value in config["versions"].items()),
        }
        made = f"```sh\n{provenance.command}\n```"
        if provenance.command is None:
            made = "The environment or the demonstrations were handed in from Python."
    table = "\n".join(f"| {name} | {_cell(value)} |" for name, value in rows.items())
    parts = [
        f"---\n{_header(policy, evaluation, title, provenance, license_id)}---",
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
    provenance: Provenance | None,
    license_id: str,
) -> str:
    """YAML, in which every JSON text is a text."""
    tags = ["reinforcement-learning", policy.env_id]
    if provenance is not None and provenance.config["num_trajectories"] is not None:
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


def _without_folder(source: str) -> str:
    """The name of a file without its folder, which is nobody else's business."""
    return source if source == PAPER_EXPERT or source.startswith("minari:") else Path(source).name


def _cell(text: str) -> str:
    """In a table, and not as Markdown or HTML, whatever it is."""
    return re.sub(r"([\\`*_{}\[\]<>|#])", r"\\\1", text)


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
