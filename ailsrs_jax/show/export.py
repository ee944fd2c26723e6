"""Write a policy for other programs, as one file or as a directory to publish."""

import importlib.util
import os
from pathlib import Path

from ailsrs_jax.data.formats.policy import FORMATS, require_format
from ailsrs_jax.data.policies import SavedPolicy, load_policy, policy_files
from ailsrs_jax.envs import Env
from ailsrs_jax.envs.registry import open_env
from ailsrs_jax.errors import UserError
from ailsrs_jax.files import require_writable, write_atomically
from ailsrs_jax.runs.evaluation import Evaluation, evaluate
from ailsrs_jax.runs.horizon import policy_horizon
from ailsrs_jax.show.model_card import find_origin, model_card, require_license

CARD = "README.md"  # the name under which the Hugging Face Hub looks for a model card


def export(
    source: str | Path | SavedPolicy,
    output: str | Path,
    *,
    num_episodes: int = 100,
    physics: str = "gymnasium",
    seed: int = 0,
    episode_length: int | None = None,
    env: Env | None = None,
    license_id: str = "unknown",
) -> Evaluation | None:
    """Write a policy as one file, or as a directory to publish.

    >>> import ailsrs_jax as ail
    >>> ail.export(ail.load_expert("swimmer"), "policy.onnx")
    >>> evaluation = ail.export(ail.load_expert("swimmer"), "swimmer", num_episodes=2)
    >>> from pathlib import Path
    >>> sorted(path.name for path in Path("swimmer").iterdir())
    ['README.md', 'policy.h', 'policy.npz', 'policy.onnx', 'policy.safetensors']

    Args:
        source: a policy, its file, or a run directory of one seed.
        output: a file that ends in .npz, .safetensors, .onnx or .h; or a new directory for files of
            all kinds and a model card. The card says what the policy is, how good it is and, if
            ``source`` is in a run directory, how it was made.
        num_episodes: the number of episodes for the return in the model card.
        physics: the physics of these episodes, as in
            :func:`~ailsrs_jax.runs.evaluation.evaluate`.
        seed: the seed of their initial states.
        episode_length: their time limit in environment steps; by default that of the run, if
            ``source`` is in one, else the environment's.
        env: the environment, as in :func:`~ailsrs_jax.runs.evaluation.evaluate`.
        license_id: the policy's licence as the Hugging Face Hub names it, such as ``apache-2.0``.

    Returns:
        The evaluation that is in the model card; None if ``output`` is a single file.

    Raises:
        UserError: the source cannot be read or holds several policies, a package is not installed,
            the policy cannot be evaluated, or the output cannot be written.
    """
    output = Path(output)
    path: Path | None = None
    if not isinstance(source, SavedPolicy):
        path, *others = policy_files(Path(source))
        if others:
            number = 1 + len(others)
            raise UserError(f"{source} holds {number} policies: choose one, for example {path}")
        source = load_policy(path)
    require_license(license_id)
    # lexists raises no error for a name that is too long, but is_dir does.
    if output.suffix and not (os.path.lexists(output) and output.is_dir()):
        source.save(output)
        return None
    origin = None if path is None else find_origin(source, path)
    _require_new(output)
    files = [output / f"policy{suffix}" for suffix in FORMATS]
    for file in files:
        require_format(file)
    if importlib.util.find_spec("huggingface_hub") is None:
        raise UserError("a model card needs pip install 'ailsrs_jax[export]'")
    if episode_length is None and path is not None:
        episode_length = policy_horizon(path)
    evaluation = evaluate(
        source, num_episodes, physics, seed, env=env, episode_length=episode_length
    )
    if evaluation.num_diverged == num_episodes:
        raise UserError("every episode diverged: there is no return for the model card")
    where = "in Gymnasium"
    if env is not None:
        where = "in an environment handed in"
    elif physics != "gymnasium":
        where = f"with physics {open_env(source.env_id, physics).engine}"
    limit = f", at most {episode_length} steps" if episode_length is not None else ""
    card = model_card(source, evaluation, f"{where}{limit}, seed {seed}", origin, license_id)
    for file in files:
        source.save(file)
    write_atomically(output / CARD, card)
    return evaluation


def _require_new(directory: Path) -> None:
    """Raise UserError unless ``directory`` can be made, or has only hidden files."""
    require_writable(directory / CARD)
    if directory.is_dir() and any(not file.name.startswith(".") for file in directory.iterdir()):
        raise UserError(f"{directory} is not empty: choose another --output")
