"""Taking a policy away: as one file, or as a directory to publish."""

import os
from pathlib import Path

from ailsrs_jax.data.formats.policy import FORMATS, require_format
from ailsrs_jax.data.policies import SavedPolicy, load_policy, policy_files
from ailsrs_jax.envs import Env
from ailsrs_jax.envs.registry import open_env, require_harmless
from ailsrs_jax.errors import UserError
from ailsrs_jax.files import require_writable, write_atomically
from ailsrs_jax.runs.evaluation import Evaluation, evaluate
from ailsrs_jax.show.model_card import find_origin, model_card, require_license

CARD = "README.md"  # as the Hugging Face Hub calls a model card


def export(
    source: str | Path | SavedPolicy,
    output: str | Path,
    *,
    num_episodes: int = 100,
    physics: str = "gymnasium",
    seed: int = 0,
    env: Env | None = None,
    license_id: str = "unknown",
) -> Evaluation | None:
    """Write a policy as one file, or as a directory to publish.

    >>> import ailsrs_jax as ail
    >>> ail.export(ail.load_expert("swimmer"), "policy.onnx")
    >>> evaluation = ail.export(ail.load_expert("swimmer"), "swimmer", num_episodes=2)
    >>> from pathlib import Path
    >>> sorted(path.name for path in Path("swimmer").iterdir())
    ['README.md', 'policy.npz', 'policy.onnx', 'policy.safetensors']

    Args:
        source: a policy, its file, or a run directory of one seed.
        output: a file that ends in .npz, .safetensors or .onnx; or a new directory, for files of
            all three kinds and a model card, which says what the policy is, its return, and how it
            was made, if ``source`` is of a run directory.
        num_episodes: so many, for the return in the model card.
        physics: as in :func:`~ailsrs_jax.runs.evaluation.evaluate`.
        seed: of the initial states of those episodes.
        env: as there.
        license_id: of the policy, as the Hugging Face Hub writes it, for example ``apache-2.0``.

    Returns:
        What the model card says of the return; None of a single file.

    Raises:
        UserError: the source cannot be read or holds several policies, a package is not installed,
            the policy cannot be evaluated, or the output cannot be written.
    """
    output, path = Path(output), None
    if not isinstance(source, SavedPolicy):
        path = _only_policy(Path(source))
        source = load_policy(path)
    require_license(license_id)
    is_directory = os.path.lexists(output) and output.is_dir()  # which raises of too long a name
    if output.suffix and not is_directory:
        source.save(output)
        return None
    return _publish(source, path, output, num_episodes, physics, seed, env, license_id)


def _publish(
    policy: SavedPolicy,
    path: Path | None,
    output: Path,
    num_episodes: int,
    physics: str,
    seed: int,
    env: Env | None,
    license_id: str,
) -> Evaluation:
    """Write the directory ``output`` for ``policy``, which is from ``path`` or from nowhere."""
    origin = None if path is None else find_origin(policy, path)
    if path is not None and env is None:
        require_harmless(policy.env_id, str(path))
    _require_new(output)
    files = [output / f"policy{suffix}" for suffix in FORMATS]
    for file in files:
        require_format(file)
    evaluation = evaluate(policy, num_episodes, physics, seed, env=env)
    if evaluation.num_diverged == num_episodes:
        raise UserError("every episode diverged: there is no return for the model card")
    where = "in Gymnasium"
    if env is not None:
        where = "in an environment handed in"
    elif physics != "gymnasium":
        where = f"with physics {open_env(policy.env_id, physics).engine}"
    card = model_card(policy, evaluation, f"{where}, seed {seed}", origin, license_id)
    for file in files:
        policy.save(file)
    write_atomically(output / CARD, lambda file: file.write(card.encode()))
    return evaluation


def _only_policy(source: Path) -> Path:
    paths = policy_files(source)
    if len(paths) > 1:
        raise UserError(f"{source} holds {len(paths)} policies: choose one, for example {paths[0]}")
    return paths[0]


def _require_new(directory: Path) -> None:
    """Raise UserError unless there is a place for ``directory``; hidden files may be in it."""
    require_writable(directory / CARD)
    if directory.is_dir():
        in_the_way = [file for file in directory.iterdir() if not file.name.startswith(".")]
        if in_the_way:
            raise UserError(f"{directory} is not empty: choose another --output")
