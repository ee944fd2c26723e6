"""Minari datasets, both ways."""

import copy
import inspect
import shutil
import warnings
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec, load_env_creator

from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.data.episodes import Recording, make_episode, stack
from ailsrs_jax.errors import UserError, one_line
from ailsrs_jax.files import read_json_object, require_file, require_plausible

# Arguments of a task's constructor that change neither observations, actions nor rewards.
RENDERING = {
    "render_mode",
    "width",
    "height",
    "camera_id",
    "camera_name",
    "default_camera_config",
    "max_geom",
    "visual_options",
}

LONGEST_TIME_LIMIT = 10_000  # steps; some datasets have one of 10⁹, which is none


def load_minari(
    dataset_id: str, env_id: str, num_trajectories: int | None = None
) -> tuple[Demonstrations, int]:
    """Read a dataset, which is downloaded first if it is not on this machine.

    An episode that neither ended in a terminal state nor at the environment's time limit was cut
    off, and is left out: nobody knows how it would have gone on.

    Args:
        dataset_id: such as ``mujoco/hopper/expert-v0``.
        env_id: the Gymnasium environment that it has to be of, with its default arguments; or one's
            own task, ``module:attribute``, whose dataset may leave out what it is of.
        num_trajectories: read no more than the first so many whole episodes.

    Returns:
        the demonstrations, and how many episodes were left out.

    Raises:
        UserError: Minari is not installed, has no such dataset or cannot read it, it is of another
            environment, or its contents contradict one another.
    """
    source = f"minari:{dataset_id}"
    minari = _import_minari()
    try:
        _download(minari, dataset_id)
        _require_harmless(minari.storage.get_dataset_path(dataset_id) / "data", source)
        dataset = minari.load_dataset(dataset_id)
    except UserError:
        raise
    except Exception as error:  # the network's, the server's, or that of a damaged dataset
        raise UserError(f"cannot load {source}: {one_line(error)}") from error
    episodes, num_left_out = [], 0
    try:
        limit = _time_limit(dataset, env_id, source)
        for index, data in enumerate(dataset.iterate_episodes()):
            where = f"{source}: episode {index}"
            episode = make_episode(data.observations, data.actions, data.rewards, where)
            length = len(episode.actions)
            if limit is not None and length > limit:
                raise UserError(f"{where} has {length} steps, more than the time limit, {limit}")
            if length == limit or bool(np.ravel(data.terminations)[-1]):
                episodes.append(episode)
            else:
                num_left_out += 1
            if len(episodes) == num_trajectories:
                break
    except UserError:
        raise
    except Exception as error:  # damaged files raise whatever their readers stumble over
        raise UserError(f"{source} is damaged: {one_line(error)}") from error
    if not episodes:
        raise UserError(f"{source} holds no whole episode: {num_left_out} are cut off")
    longest = max(len(episode.actions) for episode in episodes)
    return stack(episodes, limit or 2 * longest, env_id, source), num_left_out


def require_new_minari(dataset_id: str, env_id: str) -> None:
    """Raise UserError unless such a dataset can be made: for asking before a long run."""
    minari = _import_minari()
    if env_id not in gymnasium.registry and not _is_own(env_id):
        raise UserError(
            f"a Minari dataset is of one of Gymnasium's environments, or of module:attribute, not "
            f"of {env_id}: write a .npz"
        )
    try:
        minari.dataset.minari_dataset.parse_dataset_id(dataset_id)
        exists = minari.storage.get_dataset_path(dataset_id).exists()
    except (TypeError, ValueError):
        raise UserError(
            f"a Minari dataset is called as hopper/mine-v0 is, not {dataset_id}"
        ) from None
    except OSError as error:
        raise UserError(f"cannot write minari:{dataset_id}: {error.strerror}") from error
    if exists:
        raise UserError(f"minari:{dataset_id} exists: choose another name or version")


def save_minari(recording: Recording, dataset_id: str) -> None:
    """Write a new dataset of one of Gymnasium's environments, with the default arguments.

    Of one's own task, ``module:attribute``, it has the name, but neither the code nor the ranges of
    observations and actions.

    Raises:
        UserError: it cannot be made.
    """
    demonstrations = recording.demonstrations
    if demonstrations.actions is None or demonstrations.stride != 1:
        raise UserError("a Minari dataset holds every step, and its action")
    require_new_minari(dataset_id, demonstrations.env_id)
    minari = _import_minari()
    time_limit = demonstrations.observations.shape[1]
    env: EnvSpec | gymnasium.Env[Any, Any]
    if _is_own(demonstrations.env_id):
        env = gymnasium.Env()  # of which Minari only asks the following
        env.spec = EnvSpec(demonstrations.env_id, max_episode_steps=time_limit)
        sizes = (demonstrations.observations.shape[2], demonstrations.actions.shape[2])
        boxes = (gymnasium.spaces.Box(-np.inf, np.inf, (size,)) for size in sizes)
        env.observation_space, env.action_space = boxes
    else:
        env = copy.deepcopy(gymnasium.spec(demonstrations.env_id))
        env.max_episode_steps = time_limit
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that nobody's name and address are in it
            minari.create_dataset_from_buffers(
                dataset_id,
                _buffers(recording, minari),
                env=env,
                algorithm_name="ailsrs_jax",
            )
    except Exception as error:  # a full disk, or what Minari finds wrong
        shutil.rmtree(minari.storage.get_dataset_path(dataset_id), ignore_errors=True)
        raise UserError(f"cannot write minari:{dataset_id}: {one_line(error)}") from error


def _download(minari: Any, dataset_id: str) -> None:
    """Fetch the dataset, if it is not on this machine."""
    minari.dataset.minari_dataset.parse_dataset_id(dataset_id)  # before it becomes part of a path
    if not minari.storage.get_dataset_path(dataset_id).exists():
        minari.download_dataset(dataset_id)


def _require_harmless(directory: Path, source: str) -> None:
    """Raise UserError where reading a dataset would run code, follow its links or fill the memory.

    Minari makes the environment, whose code the dataset names, if the spaces are not given; and
    HDF5 can point to other files, and hold as much of nothing as one likes in a few bytes.
    """
    import h5py

    metadata = read_json_object(directory / "metadata.json", "the description of a Minari dataset")
    for name in ("observation_space", "action_space"):
        if not isinstance(metadata.get(name), str):
            raise UserError(f"{source} does not say what its {name} is")
    if metadata.get("data_format") != "hdf5":
        raise UserError(f"{source} is not in the format hdf5, the only one that is read")
    path = directory / "main_data.hdf5"
    require_file(path)
    sizes, problems = [], []

    def visit(name: str, item: Any) -> None:
        if h5py.h5o.get_info(item.id).rc > 1:  # each is visited once, but read as often as named
            problems.append(f"has several names for {name!a}")
        if isinstance(item, h5py.Dataset):
            sizes.append(item.nbytes)
            if item.external or item.is_virtual:
                problems.append(f"points to other files: {name!a}")

    def visit_link(name: str, link: Any) -> None:
        if not isinstance(link, h5py.HardLink):
            problems.append(f"holds a link: {name!a}")

    with h5py.File(path, "r") as file:
        file.visititems(visit)
        file.visititems_links(visit_link)
        if problems:
            raise UserError(f"{source} {problems[0]}")
        num_episodes = metadata.get("total_episodes")
        if not (isinstance(num_episodes, int) and 0 <= num_episodes <= len(file)):
            raise UserError(f"{source} does not hold the number of episodes that it says")
    require_plausible(sum(sizes), path.stat().st_size, source)


def _buffers(recording: Recording, minari: Any) -> list[Any]:
    demonstrations = recording.demonstrations
    assert demonstrations.actions is not None
    time_limit = demonstrations.observations.shape[1]
    buffers = []
    for index, length in enumerate(np.asarray(demonstrations.lengths)):
        final = recording.final_observations[index]
        is_last = np.arange(length) == length - 1
        buffers.append(
            minari.data_collector.EpisodeBuffer(
                id=index,
                observations=np.vstack([demonstrations.observations[index, :length], final]),
                actions=demonstrations.actions[index, :length],
                rewards=recording.env_rewards[index, :length],
                terminations=is_last & (length < time_limit),
                truncations=is_last & (length == time_limit),
            )
        )
    return buffers


def _import_minari() -> Any:
    try:
        import minari
    except ImportError:
        raise UserError("Minari datasets need pip install 'ailsrs_jax[minari]'") from None
    return minari


def _time_limit(dataset: Any, env_id: str, source: str) -> int | None:
    """The time limit in steps, if any, of the dataset's environment, which has to be ``env_id``."""
    spec = dataset.env_spec
    if spec is None and not _is_own(env_id):
        raise UserError(f"{source} does not say which environment it is of")
    if spec is not None:
        _require_same_task(spec, env_id, source)
    for name in ("observation_space", "action_space"):
        space = getattr(dataset, name)
        if not isinstance(space, gymnasium.spaces.Box) or len(space.shape) != 1:
            raise UserError(f"{source}: its {name} is {space}, not a box of numbers")
    limit = None if spec is None else spec.max_episode_steps
    return None if limit is None or limit > LONGEST_TIME_LIMIT else int(limit)


def _is_own(env_id: str) -> bool:
    """Whether it is called ``module:attribute``; no module is imported."""
    return ":" in env_id


def _require_same_task(spec: EnvSpec, env_id: str, source: str) -> None:
    if spec.id != env_id:
        raise UserError(f"{source} is of {spec.id}, not of {env_id}")
    if _is_own(env_id):
        return
    if env_id not in gymnasium.registry:
        raise UserError(f"{source}: {env_id} is none of Gymnasium's environments")
    changed = _changed_arguments(spec)
    if changed:
        raise UserError(
            f"{source} is of {env_id} with {', '.join(changed)}: only with the default arguments "
            "is it the same task"
        )


def _changed_arguments(spec: EnvSpec) -> list[str]:
    """Arguments, and wrappers, that make another task of the one registered as ``spec.id``."""

    def plain(value: Any) -> Any:
        return list(value) if isinstance(value, tuple) else value  # as JSON knows no tuples

    registered = gymnasium.spec(spec.id)
    creator: Any = registered.entry_point
    if isinstance(creator, str):
        creator = load_env_creator(creator)
    parameters = inspect.signature(creator).parameters
    defaults = {name: parameter.default for name, parameter in parameters.items()}
    defaults |= registered.kwargs
    arguments = [
        f"{name}={value}"
        for name, value in spec.kwargs.items()
        if name not in RENDERING and (name not in defaults or plain(value) != plain(defaults[name]))
    ]
    wrappers = [wrapper.name for wrapper in spec.additional_wrappers]
    return arguments + [name for name in wrappers if not name.startswith("Record")]
