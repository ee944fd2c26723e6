"""Run GAIL of the `imitation` package (Stable-Baselines3's PPO) on one of our demonstration files.

usage: .venv-peer/bin/python experiments/peer/imitation_gail.py DEMONSTRATIONS.npz
           [--seed 0] [--target RETURN] [--max-steps 2000000] [--settings benchmark|tutorial]

It runs in the peer's own Python (`make peer` installs it from requirements.txt) and imports nothing
from our package. It trains in the Gymnasium environment that the demonstrations name. It ends with
the first evaluation that reaches the target, or after --max-steps. An evaluation happens every
EVALUATE_EVERY steps and has four episodes of the deterministic policy in another environment. It
prints one line of JSON: the steps in the training environments, the seconds since the start without
those of evaluations, the seconds of all evaluations so far, and the mean return.

Settings:
  benchmark  the settings that the package has tuned for the task
             (`imitation/scripts/config/tuned_hps` in the installed package). They were tuned on the
             variants of the tasks in seals. Those show the position, and their episodes never end
             early. Here episodes end as in Gymnasium (`allow_variable_horizon`).
  tutorial   the settings in its documentation, on the page "Train an Agent using Generative
             Adversarial Imitation Learning". They are for CartPole.
Both use eight environments, as its scripts and its documentation do.
"""

import argparse
import importlib.resources
import json
import pydoc
import tempfile
import time
from typing import Any

NUM_ENVS = 8
NUM_THREADS = 1  # of PyTorch; more threads do not help networks this small
EVALUATE_EVERY = 10_000  # steps; an evaluation follows the round that completes them
NUM_EVALUATION_EPISODES = 4  # as many as in an iteration of our `gail`
TASKS = {
    "Ant-v5": "ant",
    "HalfCheetah-v5": "half_cheetah",
    "Hopper-v5": "hopper",
    "Swimmer-v5": "swimmer",
    "Walker2d-v5": "walker",
}
TUTORIAL = {
    "algorithm_kwargs": {
        "demo_batch_size": 1024,
        "gen_replay_buffer_capacity": 512,
        "n_disc_updates_per_round": 8,
    },
    "reward": {"normalize_output_layer": None},
    "rl": {
        "batch_size": 2048 * NUM_ENVS,
        "rl_kwargs": {
            "batch_size": 64,
            "ent_coef": 0.0,
            "gamma": 0.95,
            "learning_rate": 4e-4,
            "n_epochs": 5,
        },
    },
    "policy": {"policy_cls": "MlpPolicy", "policy_kwargs": {}},
}


def find_settings(name: str, env_id: str) -> dict[str, Any]:
    """Return the settings in the form of the package's own files, with the classes they name."""
    if name == "tutorial":
        return TUTORIAL
    folder = importlib.resources.files("imitation") / "scripts/config/tuned_hps"
    text = (folder / f"gail_seals_{TASKS[env_id]}_best_hp_eval.json").read_text()
    return json.loads(
        text, object_hook=lambda item: pydoc.locate(item["py/type"]) if "py/type" in item else item
    )


def make_gail(demonstrations: dict[str, Any], settings: dict[str, Any], seed: int) -> Any:
    """Return the trainer."""
    import numpy as np
    import torch
    from imitation.algorithms.adversarial.gail import GAIL
    from imitation.data.types import Trajectory
    from imitation.rewards.reward_nets import BasicRewardNet, NormalizedRewardNet
    from imitation.util import logger, networks, util
    from stable_baselines3 import PPO

    torch.set_num_threads(NUM_THREADS)
    env_id = str(demonstrations["env_id"])
    envs = util.make_vec_env(env_id, rng=np.random.default_rng(seed), n_envs=NUM_ENVS)
    learner = PPO(
        settings["policy"]["policy_cls"],
        envs,
        policy_kwargs=settings["policy"]["policy_kwargs"],
        n_steps=settings["rl"]["batch_size"] // NUM_ENVS,
        seed=seed,
        device="cpu",
        **settings["rl"]["rl_kwargs"],
    )
    discriminator = BasicRewardNet(
        envs.observation_space, envs.action_space, normalize_input_layer=networks.RunningNorm
    )
    if settings["reward"]["normalize_output_layer"]:
        discriminator = NormalizedRewardNet(discriminator, networks.RunningNorm)
    # Their trajectories have one more observation than actions, ours have as many of both. So the
    # last action is left out.
    trajectories = [
        Trajectory(observations[:length], actions[: length - 1], infos=None, terminal=False)
        for observations, actions, length in zip(
            *(demonstrations[name] for name in ("observations", "actions", "lengths")), strict=True
        )
    ]
    return GAIL(
        demonstrations=trajectories,
        venv=envs,
        gen_algo=learner,
        reward_net=discriminator,
        allow_variable_horizon=True,
        custom_logger=logger.configure(tempfile.mkdtemp(), ()),  # spend no time on tables
        **settings["algorithm_kwargs"],
    )


def evaluate(learner: Any, env: Any) -> float:
    """Return the mean return of the deterministic policy."""
    total = 0.0
    for _ in range(NUM_EVALUATION_EPISODES):
        observation, _ = env.reset()
        done = False
        while not done:
            action, _ = learner.predict(observation, deterministic=True)
            observation, reward, terminated, truncated, _ = env.step(action)
            total += float(reward)
            done = terminated or truncated
    return total / NUM_EVALUATION_EPISODES


def main() -> None:
    """Train, and print one line for each evaluation."""
    started = time.perf_counter()
    parser = argparse.ArgumentParser()
    parser.add_argument("demonstrations")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--target", type=float, default=float("inf"))
    parser.add_argument("--max-steps", type=int, default=2_000_000)
    parser.add_argument("--settings", choices=("benchmark", "tutorial"), default="benchmark")
    arguments = parser.parse_args()

    # These imports are here so that the clock includes them: a user waits for them, too.
    import gymnasium
    import numpy as np

    with np.load(arguments.demonstrations) as file:
        demonstrations = dict(file)
    env_id = str(demonstrations["env_id"])
    gail = make_gail(demonstrations, find_settings(arguments.settings, env_id), arguments.seed)

    evaluation_seconds = 0.0
    evaluation_env = gymnasium.make(env_id)
    evaluation_env.reset(seed=arguments.seed)
    next_evaluation = EVALUATE_EVERY
    env_steps = 0
    while env_steps < arguments.max_steps:
        gail.train(gail.gen_train_timesteps)  # one round
        env_steps = gail.gen_algo.num_timesteps
        if env_steps < min(next_evaluation, arguments.max_steps):
            continue
        next_evaluation = env_steps + EVALUATE_EVERY
        evaluation_started = time.perf_counter()
        return_mean = evaluate(gail.gen_algo, evaluation_env)
        evaluation_seconds += time.perf_counter() - evaluation_started
        line = {
            "env_steps": env_steps,
            "seconds": time.perf_counter() - started - evaluation_seconds,
            "evaluation_seconds": evaluation_seconds,
            "return_mean": return_mean,
        }
        print(json.dumps(line), flush=True)
        if return_mean >= arguments.target:
            break


if __name__ == "__main__":
    main()
