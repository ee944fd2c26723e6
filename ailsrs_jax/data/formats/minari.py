"""Minari datasets, read and written."""

import copy
import inspect
import shutil
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec, load_env_creator

from ailsrs_jax.data.formats.episodes import Episode, make_episode
from ailsrs_jax.errors import UserError, one_line, refusing
from ailsrs_jax.files import read_json_object, require_file, require_plausible
from ailsrs_jax.own_code import is_own

# Arguments of a task's constructor that change neither observations, actions nor rewards.
RENDERING = {
    *("render_mode", "width", "height", "camera_id", "camera_name", "default_camera_config"),
    *("max_geom", "visual_options"),
}

LONGEST_TIME_LIMIT = 10_000  # steps; some datasets state 10⁹, which means that there is no limit


def read_minari(dataset_id: str, env_id: str) -> tuple[int | None, Iterator[tuple[Episode, bool]]]:
    """Open a dataset, after downloading it if necessary.

    Returns:
        the time limit, if any, and an iterator over each episode and whether it is whole.

    Raises:
        UserError: see :func:`~ailsrs_jax.load_minari`; the iterator raises it as well.
    """
    source = f"minari:{dataset_id}"
    minari = _import_minari()
    with refusing(f"cannot load {source}"):
        minari.dataset.minari_dataset.parse_dataset_id(dataset_id)  # before it is part of a path
        directory = minari.storage.get_dataset_path(dataset_id)
        if not directory.exists():
            minari.download_dataset(dataset_id)
        _require_harmless(directory / "data", source)
        dataset = minari.load_dataset(dataset_id)
    with refusing(f"{source} is damaged"):
        limit = _time_limit(dataset, env_id, source)
    return limit, _episodes(dataset, limit, source)


def _episodes(dataset: Any, limit: int | None, source: str) -> Iterator[tuple[Episode, bool]]:
    with refusing(f"{source} is damaged"):
        for index, data in enumerate(dataset.iterate_episodes()):
            where = f"{source}: episode {index}"
            episode = make_episode(data.observations, data.actions, data.rewards, where)
            length = episode.length
            if limit is not None and length > limit:
                raise UserError(f"{where} has {length} steps, more than the time limit, {limit}")
            yield episode, length == limit or bool(np.ravel(data.terminations)[-1])


def require_new_minari(dataset_id: str, env_id: str) -> None:
    """Raise UserError unless such a dataset can be made; called before a long run."""
    minari = _import_minari()
    if env_id not in gymnasium.registry and not is_own(env_id):
        raise UserError(
            f"a Minari dataset needs an environment of Gymnasium's or module:attribute, not "
            f"{env_id}: write a .npz file instead"
        )
    try:
        minari.dataset.minari_dataset.parse_dataset_id(dataset_id)
        exists = minari.storage.get_dataset_path(dataset_id).exists()
    except (TypeError, ValueError):
        raise UserError(
            f"{dataset_id} is not the name of a Minari dataset: use one like hopper/mine-v0"
        ) from None
    except OSError as error:
        raise UserError(f"cannot write minari:{dataset_id}: {error.strerror}") from error
    if exists:
        raise UserError(f"minari:{dataset_id} exists: choose another name or version")


def write_minari(
    dataset_id: str, env_id: str, time_limit: int, episodes: Sequence[Episode]
) -> None:
    """Write a new dataset of ``env_id`` with the default arguments.

    An episode ended in a terminal state if it is shorter than ``time_limit``.

    Raises:
        UserError: the dataset cannot be made.
    """
    require_new_minari(dataset_id, env_id)
    minari = _import_minari()
    env: EnvSpec | gymnasium.Env[Any, Any]
    if is_own(env_id):
        env = gymnasium.Env()  # Minari reads only its spec and its spaces
        env.spec = EnvSpec(env_id, max_episode_steps=time_limit)
        env.observation_space, env.action_space = (
            gymnasium.spaces.Box(-np.inf, np.inf, array.shape[1:]) for array in episodes[0][:2]
        )
    else:
        env = copy.deepcopy(gymnasium.spec(env_id))
        env.max_episode_steps = time_limit
    buffers = []
    for index, episode in enumerate(episodes):
        is_last = np.arange(episode.length) == episode.length - 1
        terminated = episode.length < time_limit
        ends = {"terminations": is_last & terminated, "truncations": is_last & (not terminated)}
        buffer = minari.data_collector.EpisodeBuffer(id=index, **episode._asdict(), **ends)
        buffers.append(buffer)
    try:
        with warnings.catch_warnings(action="ignore"):  # about the missing author and address
            minari.create_dataset_from_buffers(
                dataset_id, buffers, env=env, algorithm_name="ailsrs_jax"
            )
    except Exception as error:  # for example a full disk, or Minari's own checks
        shutil.rmtree(minari.storage.get_dataset_path(dataset_id), ignore_errors=True)
        raise UserError(f"cannot write minari:{dataset_id}: {one_line(error)}") from error


def _require_harmless(directory: Path, source: str) -> None:
    """Raise UserError where reading a dataset would run code, follow links or fill the memory.

    Minari makes the environment, whose code the dataset names, unless the spaces are given. HDF5
    files can refer to other files, and a few bytes of them can unpack to any size.
    """
    import h5py

    metadata = read_json_object(directory / "metadata.json", "the description of a Minari dataset")
    for name in ("observation_space", "action_space"):
        if not isinstance(metadata.get(name), str):
            raise UserError(f"{source} does not define its {name}")
    if metadata.get("data_format") != "hdf5":
        raise UserError(f"{source} is not in the format hdf5, the only one that is read")
    path = directory / "main_data.hdf5"
    require_file(path)
    sizes: list[int] = []
    problems: list[str] = []

    def visit(name: str, link: Any) -> None:
        if not isinstance(link, h5py.HardLink):
            problems.append(f"holds a link: {name!a}")
            return
        item = file[name]
        if h5py.h5o.get_info(item.id).rc > 1:  # visited once here, but read once for each name
            problems.append(f"has several names for {name!a}")
        if isinstance(item, h5py.Dataset):
            sizes.append(item.nbytes)
            if item.external or item.is_virtual:
                problems.append(f"points to other files: {name!a}")

    with h5py.File(path, "r") as file:
        file.visititems_links(visit)
        if problems:
            raise UserError(f"{source} {problems[0]}")
        num_episodes = metadata.get("total_episodes")
        if not (isinstance(num_episodes, int) and 0 <= num_episodes <= len(file)):
            raise UserError(f"{source} does not hold the number of episodes that it states")
    require_plausible(sum(sizes), path.stat().st_size, source)


def _import_minari() -> Any:
    try:
        import minari
    except ImportError:
        raise UserError("Minari datasets need pip install 'ailsrs_jax[minari]'") from None
    return minari


def _time_limit(dataset: Any, env_id: str, source: str) -> int | None:
    """Check that the dataset is of ``env_id``, and return the time limit in steps, if any."""
    spec = dataset.env_spec
    if spec is None and not is_own(env_id):
        raise UserError(f"{source} does not name its environment")
    if spec is not None and spec.id != env_id:
        raise UserError(f"{source} is of {spec.id}, not of {env_id}")
    if not is_own(env_id):
        _require_default_arguments(spec, source)
    for name in ("observation_space", "action_space"):
        space = getattr(dataset, name)
        if not isinstance(space, gymnasium.spaces.Box) or len(space.shape) != 1:
            raise UserError(f"{source}: its {name} is {space}, not a box of numbers")
    limit = None if spec is None else spec.max_episode_steps
    return None if limit is None or limit > LONGEST_TIME_LIMIT else int(limit)


def _require_default_arguments(spec: EnvSpec, source: str) -> None:
    """Raise UserError if the task differs from the one registered as ``spec.id``."""
    if spec.id not in gymnasium.registry:
        raise UserError(f"{source}: Gymnasium has no environment {spec.id}")

    def plain(value: Any) -> Any:
        return list(value) if isinstance(value, tuple) else value  # JSON has no tuples

    registered = gymnasium.spec(spec.id)
    creator: Any = registered.entry_point
    if isinstance(creator, str):
        creator = load_env_creator(creator)
    parameters = inspect.signature(creator).parameters
    defaults = {name: parameter.default for name, parameter in parameters.items()}
    defaults |= registered.kwargs
    changed = [
        f"{name}={value}"
        for name, value in spec.kwargs.items()
        if name not in RENDERING and (name not in defaults or plain(value) != plain(defaults[name]))
    ]
    wrappers = [wrapper.name for wrapper in spec.additional_wrappers]
    changed += [name for name in wrappers if not name.startswith("Record")]
    if changed:
        raise UserError(
            f"{source} is of {spec.id} with {', '.join(changed)}: it must have the default "
            "arguments"
        )
