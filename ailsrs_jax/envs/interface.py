"""The interface that an environment must have, and checks of it."""

import functools
import logging
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np

from ailsrs_jax.envs import Env, State
from ailsrs_jax.errors import refusing, requirement

logger = logging.getLogger(__name__)


def require_env(env: Any) -> None:
    """Raise UserError unless ``env`` can be trained in; it is traced, but not simulated.

    It need not derive from Brax's ``Env``: MuJoCo Playground's environments have the same members
    without doing so.
    """
    name = env_name(env)
    require = requirement(name)
    kind = env if isinstance(env, type) else type(env)
    require(
        not issubclass(kind, gymnasium.Env),
        "this is of Gymnasium: pass gymnasium:ID, or a function that makes it",
    )
    require(not isinstance(env, type), "this is a class: pass an instance of it")
    missing = [member for member in ("reset", "step", "action_size") if not hasattr(env, member)]
    require(not missing, f"this is not a Brax environment: it has no {', '.join(missing)}")
    require(type(env).__hash__ is not None, "it has no hash: make it a dataclass with eq=False")
    layer = env
    while layer is not None:  # wrappers of Brax and of Playground call the wrapped one env
        wrapper = type(layer).__name__
        bases = str([base.__name__ for base in type(layer).__mro__])
        for word, fault in (("Vmap", "makes it a batch"), ("AutoReset", "restarts its episodes")):
            require(word not in bases, f"{wrapper} {fault}: remove this wrapper")
        layer = getattr(layer, "env", None)

    with refusing(f"{name}: JAX cannot trace it"):
        state = jax.eval_shape(env.reset, jax.random.key(0))
        action = jax.ShapeDtypeStruct((env.action_size,), np.float32)
        next_state = jax.eval_shape(env.step, state, action)
        scalars = state.reward.shape, state.done.shape
        kind = type(state.obs)
        n, p = env_sizes(env) if kind is jax.ShapeDtypeStruct else (0, 0)
    require(n > 0, f"its observation is a {kind.__name__}: a linear policy needs a single vector")
    require(
        state.obs.shape == (n,) and jnp.issubdtype(state.obs.dtype, jnp.floating),
        f"its observation is {state.obs.dtype}{list(state.obs.shape)}, its observation_size "
        f"promises {n} floats",
    )
    require(scalars == ((), ()), f"reward and done have the shapes {scalars}, not those of scalars")
    changed = _changed_types(state, next_state)
    require(not changed, f"step changes the shape or type of the state's {', '.join(changed)}")
    low, high = map(np.asarray, action_range(env))
    require(
        low.shape == high.shape == (p,) and bool(np.all((low < high) & np.isfinite(high - low))),
        f"its {p} actions go from {low.tolist()} to {high.tolist()}: give each action a range "
        "(in a MuJoCo model, give every actuator a ctrlrange)",
    )


def has_own(env: Any, ability: str) -> bool:
    """Whether the class of ``env`` has the property ``ability``, and it is true.

    Wrappers hand on what the environment in them has. But if that one runs a whole episode, it
    does not call the ``step`` of the wrapper.
    """
    return hasattr(type(env), ability) and bool(getattr(env, ability))


@functools.lru_cache(maxsize=4)
def starts_at_observations(env: Any) -> bool:
    """Whether ``env.state_at`` can be used; if not, it logs a warning, once per environment."""
    can = has_own(env, "state_at") and bool(getattr(env, "sets_observations", True))
    if not can:
        logger.warning(
            "%s cannot be put into a demonstrated state, so all episodes start with a reset; an "
            "environment of Gymnasium can if it has a method set_observation(observation)",
            getattr(env, "env_id", env_name(env)),
        )
    return can


def env_name(env: Env) -> str:
    """Return the name of the environment's class, without its wrappers."""
    return (env if isinstance(env, type) else type(getattr(env, "unwrapped", env))).__name__


def own_env_id(env: Any) -> str | None:
    """Return the name by which the task ``env`` was made; a wrapper around it is another task."""
    return getattr(env, "__dict__", {}).get("env_id")


def env_sizes(env: Env) -> tuple[int, int]:
    """Return the sizes n and p of observations and actions.

    They are computed under a trace, because Brax's own environments simulate a reset to find their
    size. With MJX and without a trace that takes half a minute.
    """
    n, p = jax.eval_shape(lambda: jnp.zeros((env.observation_size, env.action_size))).shape
    return n, p


def action_range(env: Env) -> tuple[jax.Array, jax.Array]:
    """Return the lowest and highest action, ``(p,)`` each; Brax's are −1 and 1."""
    ones = jnp.ones(env.action_size)
    low, high = getattr(env, "action_low", -ones), getattr(env, "action_high", ones)
    return jnp.asarray(low), jnp.asarray(high)


def _changed_types(state: State, next_state: State) -> list[str]:
    """Names of the state's leaves whose shape or type a loop over steps cannot carry."""
    before, after = (dict(jax.tree_util.tree_leaves_with_path(x)) for x in (state, next_state))
    changed = before.keys() ^ after.keys()
    for path in before.keys() & after.keys():
        old, new = before[path], after[path]
        # A plain Python number has a weak type, which JAX adapts.
        if old.shape != new.shape or (old.dtype != new.dtype and not old.weak_type):
            changed.add(path)
    return sorted(jax.tree_util.keystr(path).lstrip(".") for path in changed)
