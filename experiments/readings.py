"""Clone the experts under each reading of what the paper's behaviour cloning was.

usage: python -m experiments.readings    (writes readings.json beside it)

The paper does not say whether its experts were linear or neural, whether its demonstrations hold
the actions before or after they are clipped to the range of the actuators, or how long Adam went
on. For each answer, the paper's linear policy is cloned from the numbers of demonstrations for
which the paper gives a return.
"""

import dataclasses
import itertools
import json
from pathlib import Path
from typing import Any

import jax
import numpy as np

import ailsrs_jax as ail
from ailsrs_jax.data.demonstrations import Demonstrations
from ailsrs_jax.data.policies import expert_path
from ailsrs_jax.runs.demonstrate import expert_demonstrations
from ailsrs_jax.show.sweep_report import markdown_table
from experiments.evidence import CHEETAH, HOPPER, PAPER_CLONES, SWIMMER, WALKER
from experiments.rules import close_to_paper, paper_share, short

RESULTS = Path(__file__).with_suffix(".json")
NUM_SEEDS = 3
NUM_EPISODES = 20  # of each clone, on the C engine
# The names of their files.
EXPERTS: dict[str, dict[str, str | None]] = {
    "neural": {CHEETAH: None, HOPPER: None, WALKER: "paper", SWIMMER: None},
    "linear": dict.fromkeys((CHEETAH, HOPPER, WALKER, SWIMMER), "linear"),
}
PASSES = {"5 passes": 5, "15 passes": 15, "50 passes": 50, "the exact solution": None}


def main() -> None:
    """Clone under all readings, and print the table."""
    jax.config.update("jax_platforms", "cpu")
    rows: list[dict[str, Any]] = []
    for expert, clipped in itertools.product(EXPERTS, (True, False)):
        for task, name in EXPERTS[expert].items():
            for number in PAPER_CLONES[task]:
                demonstrations = read_demonstrations(task, name, number, clipped)
                whole = float(demonstrations.returns.mean())
                for training, passes in PASSES.items():
                    returns = clone_returns(task, demonstrations, passes)
                    reading = {"expert": expert, "clipped": clipped, "training": training}
                    row = {"env_id": task, "number": number, "shares": list(returns / whole)}
                    rows.append(reading | row)
                    print(rows[-1], flush=True)
                RESULTS.write_text(json.dumps(rows, indent=1) + "\n")
    print(table())


def read_demonstrations(task: str, name: str | None, number: int, clipped: bool) -> Demonstrations:
    """Return episodes of an expert, with the actions that it asked for if not ``clipped``."""
    demonstrations = expert_demonstrations(task, number, "mujoco", name)
    if clipped:
        return demonstrations
    policy = ail.load_policy(expert_path(task, name))
    free = np.full_like(policy.action_low, np.inf)
    unbounded = dataclasses.replace(policy, action_low=-free, action_high=free)
    episodes, steps, _ = np.shape(demonstrations.observations)
    actions = unbounded(np.reshape(demonstrations.observations, (episodes * steps, -1)))
    return demonstrations.replace(actions=actions.reshape(episodes, steps, -1))


def clone_returns(task: str, demonstrations: Demonstrations, passes: int | None) -> np.ndarray:
    """Return the mean return ``(NUM_SEEDS,)`` of each clone."""
    settings = ail.BehaviorCloningSettings(num_iterations=1, num_evaluation_episodes=NUM_EPISODES)
    if passes is None:
        settings = dataclasses.replace(settings, solver="ridge")
    else:
        steps = passes * int(np.sum(demonstrations.lengths)) // settings.batch_size
        settings = dataclasses.replace(settings, gradient_steps=steps)
    trainer = ail.make_behavior_cloning(ail.make_env(task, "mujoco"), demonstrations, settings)
    keys = jax.random.split(jax.random.key(0), NUM_SEEDS)
    _, metrics = jax.jit(jax.vmap(trainer.train))(keys)
    return np.asarray(metrics["evaluation_return"], float)[:, 0]


def table() -> str:
    """Return the shares of the expert's return as Markdown; those close to the paper's are bold."""
    means: dict[tuple[str, bool, str], dict[tuple[str, int], float]] = {}
    for row in json.loads(RESULTS.read_text()):
        reading = row["expert"], row["clipped"], row["training"]
        where = row["env_id"], row["number"]
        means.setdefault(reading, {})[where] = float(np.mean(row["shares"]))
    given = [(task, number) for task in PAPER_CLONES for number in PAPER_CLONES[task]]
    lines = [["the paper", "", "", *(f"{paper_share(*where):.2f}" for where in given)]]
    for (expert, clipped, training), found in means.items():
        fields = []
        for where in given:
            text = f"{found[where]:z.2f}" if where in found else "–"
            near = where in found and close_to_paper(found[where], *where)
            fields.append(f"**{text}**" if near else text)
        lines.append([expert, "clipped" if clipped else "unclipped", training, *fields])
    columns = [f"{short(task)} {number}" for task, number in given]
    return markdown_table(["expert", "actions", "Adam", *columns], lines)


if __name__ == "__main__":
    main()
