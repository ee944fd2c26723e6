"""Demonstrations from and to the datasets of other libraries, which hold whole episodes."""

import dataclasses
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from ailsrs_jax.data.demonstrations import Demonstrations, validated
from ailsrs_jax.data.formats.episodes import Episode
from ailsrs_jax.data.formats.imitation import read_imitation
from ailsrs_jax.data.formats.minari import read_minari, write_minari
from ailsrs_jax.errors import UserError


@dataclasses.dataclass(frozen=True, eq=False)
class Recording:
    """Demonstrations, with the rewards and final observations that other formats need."""

    demonstrations: Demonstrations
    env_rewards: np.ndarray  #: (E, T) float32, of the environment
    final_observations: np.ndarray  #: (E, n) float32, after the last action


def load_minari(
    dataset_id: str, env_id: str, num_trajectories: int | None = None
) -> tuple[Demonstrations, int]:
    """Read a Minari dataset, which is downloaded first if it is not on this machine.

    An episode that ended neither in a terminal state nor at the environment's time limit was cut
    off. It is left out, because its end is unknown. If the environment has no time limit, all
    episodes ended in a terminal state. The time limit of the demonstrations is then twice the
    length of the longest episode in the dataset.

    Args:
        dataset_id: for example ``mujoco/hopper/expert-v0``.
        env_id: the dataset's environment: one of Gymnasium's, with its default arguments; or your
            own task, ``module:attribute``, which the dataset need not name.
        num_trajectories: the maximum number of whole episodes to read.

    Returns:
        the demonstrations, and the number of episodes that were left out.

    Raises:
        UserError: Minari is not installed, has no such dataset or cannot read it, it is of another
            environment, or its contents contradict one another.
    """
    time_limit, pairs = read_minari(dataset_id, env_id)
    return _collect(
        pairs, num_trajectories, env_id, f"minari:{dataset_id}", time_limit=time_limit, spare=2
    )


def save_minari(recording: Recording, dataset_id: str) -> None:
    """Write a new Minari dataset of one of Gymnasium's environments, with the default arguments.

    A dataset of your own task, ``module:attribute``, holds its name, but neither its code nor the
    ranges of observations and actions.

    Raises:
        UserError: the dataset cannot be made.
    """
    demonstrations = recording.demonstrations
    actions = demonstrations.actions
    if actions is None or demonstrations.stride != 1:
        raise UserError("a Minari dataset needs the action of every step")
    episodes = [
        Episode(
            np.vstack([demonstrations.observations[index, :length], final]),
            np.asarray(actions[index, :length]),
            recording.env_rewards[index, :length],
        )
        for index, (length, final) in enumerate(
            zip(np.asarray(demonstrations.lengths), recording.final_observations, strict=True)
        )
    ]
    time_limit = demonstrations.observations.shape[1]
    write_minari(dataset_id, demonstrations.env_id, time_limit, episodes)


def load_imitation(
    directory: str | Path, env_id: str, num_trajectories: int | None = None
) -> tuple[Demonstrations, int]:
    """Read a directory of trajectories of the ``imitation`` library; nothing is unpickled.

    The format names neither the environment nor its time limit. A trajectory that is not
    ``terminal`` is part of an episode and is left out. Every other one ended in a terminal state or
    at the time limit, which is assumed to be the length of the longest in the directory.

    Args:
        directory: as ``imitation.data.serialize.save`` writes it, with rewards.
        env_id: the environment of the trajectories.
        num_trajectories: the maximum number of whole episodes to read.

    Returns:
        the demonstrations, and the number of trajectories that were left out.

    Raises:
        UserError: it is not such a directory, pyarrow is not installed, or the contents contradict
            one another.
    """
    return _collect(read_imitation(Path(directory)), num_trajectories, env_id, str(directory))


def stack(episodes: Sequence[Episode], num_steps: int, env_id: str, source: str) -> Demonstrations:
    """Make demonstrations with a time limit of ``num_steps``, which no episode exceeds.

    Raises:
        UserError: the episodes have different sizes, or hold NaN or infinity.
    """
    sizes = sorted({(x.observations.shape[1], x.actions.shape[1]) for x in episodes})
    if len(sizes) > 1:
        raise UserError(f"{source}: the numbers of observations and actions differ: {sizes}")

    def padded(arrays: Sequence[np.ndarray]) -> np.ndarray:
        batch = np.zeros((len(arrays), num_steps, arrays[0].shape[1]), np.float32)
        for row, array in zip(batch, arrays, strict=True):
            row[: len(array)] = array
        return batch

    with np.errstate(over="ignore"):  # what becomes infinite is refused below
        returns = np.array([x.rewards.sum(dtype=np.float64) for x in episodes])
    fields = {
        "observations": padded([episode.observations[:-1] for episode in episodes]),
        "actions": padded([episode.actions for episode in episodes]),
        "lengths": np.array([episode.length for episode in episodes]),
        "returns": returns,
        "env_id": env_id,
    }
    return validated(fields, source)


def _collect(
    pairs: Iterable[tuple[Episode, bool]],
    num_trajectories: int | None,
    env_id: str,
    source: str,
    *,
    time_limit: int | None = None,
    spare: int = 1,
) -> tuple[Demonstrations, int]:
    """Stack the first whole episodes; return also the number of cut-off ones among them.

    If there is no ``time_limit`` it becomes ``spare`` times the length of the longest of all whole
    episodes.
    """
    episodes: list[Episode] = []
    num_left_out = longest = 0
    for episode, is_whole in pairs:
        is_needed = len(episodes) != num_trajectories
        if is_whole:
            longest = max(longest, episode.length)
        if is_whole and is_needed:
            episodes.append(episode)
        elif is_needed:
            num_left_out += 1
        if len(episodes) == num_trajectories and time_limit is not None:
            break
    if not episodes:
        raise UserError(f"{source} holds no whole episode: {num_left_out} are cut off")
    return stack(episodes, time_limit or spare * longest, env_id, source), num_left_out
