"""Models of MuJoCo, by their files."""

import os
from importlib import resources
from pathlib import Path

import mujoco

from ailsrs_jax.envs.physics.quiet import without_warnings
from ailsrs_jax.errors import UserError


def model_path(xml_file: str) -> Path:
    """Return the path of one of Gymnasium's models by its file name, or of your own by its path.

    Raises:
        UserError: the file does not exist.
    """
    path = Path(xml_file).expanduser()
    if not xml_file.startswith((".", "~", os.sep)):
        path = Path(str(resources.files("gymnasium")), "envs", "mujoco", "assets", xml_file)
    if not path.is_file():
        raise UserError(f"no model file {path}")
    return path


def load_model(xml_file: str) -> mujoco.MjModel:
    """Read one of Gymnasium's models by its file name, or your own by its path.

    Raises:
        UserError: the file does not exist, or MuJoCo cannot read it.
    """
    path = model_path(xml_file)
    try:
        with without_warnings():  # for example, that a model is outdated
            return mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise UserError(f"MuJoCo cannot read {path}: {str(error).splitlines()[0]}") from error
