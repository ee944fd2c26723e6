"""The horizon T of a run: the number of steps after which an episode is cut off.

It is the setting ``episode_length`` if that is given, else the time limit of the demonstrations,
else the environment's, else the preset's. Training, all evaluations and all pictures of the run
have the same.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.storage.config import find_run, read_config
from ailsrs_jax.runs.storage.policies import EVALUATED

EPISODE_LENGTH = 1000  # Gymnasium's time limit for all of the tasks
LONGEST = 10_000  # steps that only a file asks for; simulating more could fill the memory


def env_horizon(env: Any) -> int:
    """Return the time limit of the environment, 1000 if it has none."""
    return getattr(env, "time_limit", None) or EPISODE_LENGTH


def saved_horizon(config: Mapping[str, Any], where: Path) -> int | None:
    """Return the horizon of the run that wrote ``config`` to ``where``; None if it says none.

    Raises:
        UserError: it is no number of steps, or too large.
    """
    settings = config.get("settings")
    value = settings.get("episode_length") if isinstance(settings, dict) else None
    if value is None:
        return None
    if type(value) is not int or not 1 <= value <= LONGEST:
        raise UserError(
            f"{where}: episode_length is {value!s:.40}, not from 1 to {LONGEST}: if it is meant, "
            "evaluate with --episode-length"
        )
    return value


def policy_horizon(path: Path) -> int | None:
    """Return the horizon of the run that the policy at ``path`` is in, or None.

    Raises:
        UserError: the configuration of the run is damaged.
    """
    folder = path.absolute().parent
    origin = find_run(folder if folder.name == EVALUATED else path)
    if origin is None:
        return None
    file = origin[0] / "config.json"
    return saved_horizon(read_config(file), file)
