"""A page on which policies run: MuJoCo and the policies in the browser, without a server."""

import base64
import gzip
import json
from collections.abc import Mapping
from typing import Any

import jax
import jinja2
import markupsafe
import mujoco
import numpy as np

from ailsrs_jax.data.policies import SavedPolicy
from ailsrs_jax.envs.physics import Range
from ailsrs_jax.envs.registry import make_env
from ailsrs_jax.envs.tasks.ant import Ant
from ailsrs_jax.envs.tasks.entry_names import action_names, observation_names
from ailsrs_jax.envs.tasks.gymnasium_task import GymnasiumTask
from ailsrs_jax.envs.tasks.model_file import model_path
from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.evaluation import EVALUATION_STREAM
from ailsrs_jax.runs.horizon import EPISODE_LENGTH
from ailsrs_jax.show.episodes.wasm import VERSION, mujoco_build

# The direction from which each task is seen.
VIEWS = {
    "Ant-v5": "oblique",
    "HalfCheetah-v5": "side",
    "Hopper-v5": "side",
    "Swimmer-v5": "top",
    "Walker2d-v5": "side",
}
NUM_STARTS = 20
LARGEST = 1e300  # in place of infinity, which JSON lacks
TEMPLATES = jinja2.Environment(  # of all pages
    loader=jinja2.PackageLoader("ailsrs_jax", "show"),
    autoescape=True,
    undefined=jinja2.StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
)


def require_playable(env_id: str) -> None:
    """Raise UserError unless the page knows the task."""
    if env_id not in VIEWS:
        raise UserError(
            f"the page cannot play {env_id}: it knows {', '.join(VIEWS)}; make a video instead"
        )


def play_html(
    policies: Mapping[str, SavedPolicy],
    *,
    title: str,
    seed: int = 0,
    episode_length: int | None = None,
) -> str:
    """Return a page that runs policies of one task in closed loop. It loads nothing.

    Args:
        policies: by what the page calls them; it begins with the first.
        title: of the page.
        seed: of the initial states; they are those of ``evaluate`` on an engine of this package.
        episode_length: the time limit in environment steps; by default the task's own.

    Raises:
        UserError: the page does not know the task, a policy does not fit it, or npm cannot fetch
            MuJoCo's WebAssembly build.
    """
    scene = play_scene(policies, seed, episode_length or EPISODE_LENGTH)
    build = mujoco_build()
    return TEMPLATES.get_template("episodes/play.html").render(
        title=title,
        env_id=scene["env_id"],
        version=VERSION,
        # In JSON "<" can only be in strings. Without it no string can end the script.
        scene=markupsafe.Markup(json.dumps(scene, allow_nan=False).replace("<", "\\u003c")),
        program=base64.b64encode(gzip.compress(build.program, mtime=0)).decode(),
        mujoco=markupsafe.Markup(build.script),
    )


def play_scene(
    policies: Mapping[str, SavedPolicy], seed: int, episode_length: int
) -> dict[str, Any]:
    """Return what the script knows: the task in numbers, its model, initial states, and policies.

    Raises:
        UserError: the page does not know the task, or a policy does not fit it.
    """
    env_id, *others = sorted({policy.env_id for policy in policies.values()})
    if others:
        raise UserError(f"the policies are of several tasks: {env_id}, {', '.join(others)}")
    require_playable(env_id)
    task: Any = make_env(env_id, "mujoco")
    assert isinstance(task, GymnasiumTask)
    for policy in policies.values():
        policy.require_shape(task.action_size, task.observation_size)
    key = jax.random.fold_in(jax.random.key(seed), EVALUATION_STREAM)
    keys = jax.vmap(lambda number: jax.random.fold_in(key, number))(np.arange(NUM_STARTS))
    starts = jax.vmap(task.draw_start)(keys)
    position, contact = {"field": "qpos", "at": 0}, None
    if isinstance(task, Ant):
        position = {"field": "xpos", "at": 3 * task._main_body}
        low, high = task.contact_force_range
        contact = {"weight": task.contact_cost_weight, "low": low, "high": high}
    return {
        "env_id": env_id,
        "view": VIEWS[env_id],
        "xml": model_path(task.xml_file).read_text(),
        "frame_skip": task.frame_skip,
        "episode_length": episode_length,
        "observed": [_range(task, part) for part in task._observed()],
        "limits": [_range(task, part) for part in task._limits()],
        "position": position,
        "reward": {
            "forward": task.forward_reward_weight,
            "control": task.ctrl_cost_weight,
            "healthy": getattr(task, "healthy_reward", 0.0),
            "contact": contact,
        },
        "starts": [
            {"qpos": qpos, "qvel": qvel}
            for qpos, qvel in zip(starts.qpos.tolist(), starts.qvel.tolist())
        ],
        "entries": observation_names(task),
        "actions": action_names(task),
        "policies": [
            {
                "name": name,
                "mean": policy.mean.tolist(),
                "std": policy.std.tolist(),
                "low": policy.action_low.tolist(),
                "high": policy.action_high.tolist(),
                "layers": [{"weights": w.tolist(), "biases": b.tolist()} for w, b in policy.layers],
            }
            for name, policy in policies.items()
        ],
    }


def _range(task: GymnasiumTask, part: Range) -> dict[str, Any]:
    size = getattr(mujoco.MjData(task.physics.model), part.field).size
    low, high = np.clip(np.array([part.low, part.high], float), -LARGEST, LARGEST).tolist()
    end = size if part.end is None else part.end
    return {"field": part.field, "first": part.first, "end": end, "low": low, "high": high}
