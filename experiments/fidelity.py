"""Compare MJX and our C engine with Gymnasium's own environments: one step, and whole episodes.

usage: python -m experiments.fidelity [ENV ...]    (from the project's root)

It prints two tables. The first has the errors of one environment step, from states that random
actions and the expert (if the package has one for the task) visit. The second has the returns of
the experts and of a policy trained on MJX, in Gymnasium and in both engines: the mean over 100
episodes and its 95 % confidence interval.
"""

import sys
from pathlib import Path

import numpy as np

from ailsrs_jax.data.policies import load_policy
from ailsrs_jax.envs.registry import TASKS, make_env, resolve_env_id, short_name
from ailsrs_jax.runs.evaluation import evaluate
from tests.envs.test_gymnasium_agreement import gymnasium_steps, our_steps

ENGINES = ("mjx", "mujoco")
NUM_STEPS = 4000
NUM_EPISODES = 100
TRAINED_ON_MJX = "experiments/physics/swimmer_mjx/seed_0/policy.npz"


def print_step_errors(env_ids: list[str]) -> None:
    """Print the median and the 99th percentile over steps of the largest error of a step."""
    print("| task | engine | velocities [m/s, rad/s] | observations | reward | done differs |")
    print("|---|---|---|---|---|---|")
    for env_id in env_ids:
        steps = gymnasium_steps(env_id, NUM_STEPS)
        for physics in ENGINES:
            state, physics_state = our_steps(make_env(env_id, physics), steps)
            scale = np.maximum(1.0, np.abs(steps.next_observation))
            errors = [
                np.abs(physics_state.qvel - steps.next_qvel).max(axis=1),
                (np.abs(state.obs - steps.next_observation) / scale).max(axis=1),
                np.abs(state.reward - steps.reward),
            ]
            cells = [f"{np.median(e):.1e} / {np.quantile(e, 0.99):.1e}" for e in errors]
            differs = int(np.sum(np.asarray(state.done, bool) != steps.terminated))
            cells.append(f"{differs} of {NUM_STEPS}, {int(steps.terminated.sum())} ended")
            print(f"| {short_name(env_id)} | {physics} | {' | '.join(cells)} |", flush=True)


def print_returns(env_ids: list[str]) -> None:
    """Print the returns of the same policies in Gymnasium and in both engines."""
    places = ("gymnasium", *ENGINES)
    print(f"| policy | {' | '.join(places)} |")
    print("|---|---|---|---|")
    paths = [Path("ailsrs_jax/data/experts") / f"{env_id}.npz" for env_id in env_ids]
    if "Swimmer-v5" in env_ids:
        paths.append(Path(TRAINED_ON_MJX))
    for path in filter(Path.exists, paths):
        cells = []
        for physics in places:
            returns = evaluate(load_policy(path), NUM_EPISODES, physics).returns
            interval = 1.96 * returns.std(ddof=1) / np.sqrt(NUM_EPISODES)
            cells.append(f"{returns.mean():.1f} ± {interval:.1f}")
        print(f"| {path} | {' | '.join(cells)} |", flush=True)


def main() -> None:
    """Print both tables."""
    env_ids = [resolve_env_id(name) for name in sys.argv[1:]] or list(TASKS)
    print_step_errors(env_ids)
    print()
    print_returns(env_ids)


if __name__ == "__main__":
    main()
