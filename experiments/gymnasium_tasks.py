"""Train AILSRS in environments of Gymnasium that the package does not know.

usage: python -m experiments.gymnasium_tasks [TASK...]    (writes gymnasium_tasks.json beside it)

Needs ``pip install "gymnasium[box2d]" "shimmy[dm-control]"``. Each task has a controller that is
written here, or trained by augmented random search on the reward. Ten of its episodes are
demonstrations for the preset ``tuned``. A score of 0 is the return of noise or of no action,
whichever is better, and 1 the controller's. Results of other tasks stay in the file.
"""

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

import ailsrs_jax as ail
from ailsrs_jax.show.sweep_report import markdown_table

RESULTS = Path(__file__).with_suffix(".json")
SEEDS = [0, 1, 2]
NUM_DEMONSTRATIONS = 10
NUM_EPISODES = 50  # of each evaluation, with seeds that neither training nor demonstrations use
EVALUATION_SEED = 10_000
NOISE = 1.0  # standard deviation of actions that are noise, in their units


def double_pendulum(observation: np.ndarray) -> np.ndarray:
    """Act linearly: the optimal gains where it stands upright (LQR)."""
    gains = np.array([0.21, 1.81, 5.57, 0.31, 0.90, 0.85])
    return -gains @ observation[[0, 1, 2, 5, 6, 7], None]


def reacher(observation: np.ndarray) -> np.ndarray:
    """Pull the fingertip to the target: the transposed Jacobian, and damping."""
    (c1, c2, s1, s2), speeds, error = observation[:4], observation[6:8], observation[8:10]
    c12, s12 = c1 * c2 - s1 * s2, s1 * c2 + c1 * s2
    elbow, arm = np.array([-0.11 * s12, 0.11 * c12]), np.array([-0.1 * s1, 0.1 * c1])
    return -20 * np.array([arm + elbow, elbow]) @ error - 0.1 * speeds


def pendulum(observation: np.ndarray) -> np.ndarray:
    """Swing up by the energy, then hold."""
    cosine, sine, speed = observation
    if cosine > 0.7:
        return np.array([-8 * sine - 2 * speed])
    missing = 5 + 10 * (1 - cosine) - 0.5 * speed**2
    return np.array([2 * np.sign(speed * missing or 1.0)])


def lunar_lander(observation: np.ndarray) -> np.ndarray:
    """Do as Gymnasium's own heuristic."""
    from gymnasium.envs.box2d.lunar_lander import heuristic

    env = SimpleNamespace(unwrapped=SimpleNamespace(continuous=True))
    return np.array(heuristic(env, observation))


def cartpole(observation: np.ndarray) -> np.ndarray:
    """Balance the pole linearly; the observation is position, cosine, sine and two velocities."""
    return np.array([0.5, 0.0, 5.0, 1.0, 1.0]) @ observation[:, None]


def dock(observation: np.ndarray) -> np.ndarray:
    """Steer to the berth, by rotating the wanted force into the boat's frame."""
    position, velocity, (cosine, sine) = np.split(observation, 3)
    x, y = -0.8 * position - 1.2 * velocity - [0.3, -0.2]
    return np.array([cosine * x + sine * y, 2 * (cosine * y - sine * x)])


class Task(NamedTuple):
    """An environment, who demonstrates there, and settings that the size of the task asks for."""

    env: str
    controller: Callable[[np.ndarray], np.ndarray] | dict[str, Any]  # settings of ARS train one
    settings: dict[str, Any]
    reason: str = ""  # in which way the controller is not linear


ROTATES = "the controller rotates a force, so it multiplies observations with one another"
TASKS = {
    "double_pendulum": Task(
        "gymnasium:InvertedDoublePendulum-v5", double_pendulum, {"num_iterations": 5}
    ),
    "reacher": Task("gymnasium:Reacher-v5", reacher, {}, ROTATES),
    "pusher": Task(
        "gymnasium:Pusher-v5",
        {"num_iterations": 150, "num_directions": 16, "num_top_directions": 8},
        {"num_iterations": 40},
    ),
    "pendulum": Task(
        "gymnasium:Pendulum-v1",
        pendulum,
        {"num_iterations": 60},
        "the controller switches between swinging up and holding, which have opposite signs",
    ),
    "lunar_lander": Task(
        "gymnasium:LunarLanderContinuous-v3",
        lunar_lander,
        {"num_iterations": 30},
        "the heuristic switches engines at thresholds and has other rules on the ground",
    ),
    "dm_control": Task(
        "gymnasium:shimmy:dm_control/cartpole-balance-v0", cartpole, {"num_iterations": 2}
    ),
    "dock": Task("gymnasium:experiments.dock:Dock-v0", dock, {"num_iterations": 60}, ROTATES),
}


def main() -> None:
    """Measure the tasks of the command line, or all."""
    for name in sys.argv[1:] or TASKS:
        row = measure(TASKS[name])
        results = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
        RESULTS.write_text(json.dumps(results | {name: row}, indent=1) + "\n")
    print(table())


def table() -> str:
    """Return the results as Markdown."""
    results = json.loads(RESULTS.read_text())
    lines, reasons = [], []
    for name in (name for name in TASKS if name in results):
        row, env = results[name], f"`{TASKS[name].env.removeprefix('gymnasium:')}`"
        numbers = (row["at_rest"], row["noise"], row["controller"], *row["returns"])
        rest, noise, controller, *returns = (f"{number:.1f}" for number in numbers)
        lines.append([env, rest, noise, controller, ", ".join(returns), f"{row['score']:.2f}"])
        if row["score"] < 0.9 and TASKS[name].reason:
            reasons.append(f"- {env}: {TASKS[name].reason}.")
    header = ["environment", "no action", "noise", "controller", "AILSRS, each seed", "score"]
    explanation = "Where the score is below 0.9, the controller is not linear:"
    return "\n".join([markdown_table(header, lines), "", explanation, "", *reasons])


def measure(task: Task) -> dict[str, Any]:
    """Demonstrate, train, evaluate."""
    controller = task.controller
    if isinstance(controller, dict):
        controller = ail.train(task.env, algorithm="ars", **controller).policies[0]
    demonstrations = ail.demonstrate(controller, NUM_DEMONSTRATIONS, env=task.env)
    started = time.time()
    run = ail.train(task.env, demonstrations, seeds=SEEDS, **task.settings)
    seconds = time.time() - started
    size = demonstrations.actions.shape[2]
    at_rest, noise = (mean_return(task.env, lambda _: np.zeros(size), x) for x in (0.0, NOISE))
    best = mean_return(task.env, controller)
    returns = [mean_return(task.env, run.policies[seed]) for seed in SEEDS]
    zero = max(at_rest, noise)
    return {
        "env": task.env,
        "seeds": SEEDS,
        "settings": task.settings,
        "num_demonstrations": NUM_DEMONSTRATIONS,
        "episodes": NUM_EPISODES,
        "at_rest": at_rest,
        "noise": noise,
        "controller": best,
        "returns": returns,
        "score": float((np.mean(returns) - zero) / (best - zero)),
        "seconds": round(seconds),
    }


def mean_return(env: str, policy: Any, noise: float = 0.0) -> float:
    """Evaluate any policy."""
    episodes = ail.demonstrate(
        policy, NUM_EPISODES, env=env, seed=EVALUATION_SEED, action_noise=noise
    )
    return float(episodes.returns.mean())


if __name__ == "__main__":
    main()
