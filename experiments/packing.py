"""How much of what MJX simulates is alive, over the first iterations of a task that ends early.

usage: python experiments/packing.py [ENV] [ITERATIONS]    (hopper, 50; N = 320, T = 1000)

Trains with the paper's preset, from zero weights, and compares the slots' steps with what a rollout
without refilling would have simulated: every episode as long as the longest of its device.
"""

import sys
from typing import Any
from unittest import mock

import jax
import numpy as np

from ailsrs_jax.envs.registry import make_env, resolve_env_id
from ailsrs_jax.runs.demonstrate import expert_demonstrations
from ailsrs_jax.runs.devices import choose_batch_size, choose_devices, set_up_jax
from ailsrs_jax.trainers import ailsrs
from ailsrs_jax.trainers.algorithms import preset_settings
from ailsrs_jax.trainers.parts import exploration


def main() -> None:
    """Print the shares of live steps, every ten iterations."""
    set_up_jax()
    env_id = resolve_env_id(sys.argv[1] if len(sys.argv) > 1 else "hopper")
    num_iterations = int(sys.argv[2]) if len(sys.argv) > 2 else 50
    settings = preset_settings(env_id, "paper")
    env = make_env(env_id, "mjx")
    devices = choose_devices(env, settings.num_directions)
    totals = {"live": 0, "slots": 0, "plain": 0}

    def count(lengths: np.ndarray, slot_steps: np.ndarray) -> None:
        totals["live"] += int(lengths.sum())
        totals["slots"] += int(slot_steps)
        totals["plain"] += int(lengths.max()) * len(lengths)

    def counting(*arguments: Any) -> Any:
        batch = exploration_rollout(*arguments)
        jax.debug.callback(count, batch.lengths, batch.slot_steps)  # once on every device
        return batch

    exploration_rollout = exploration.rollout
    with mock.patch.object(exploration, "rollout", counting):
        demonstrations = expert_demonstrations(env_id, 10, "mujoco")
        trainer = ailsrs.make_ailsrs(env, demonstrations, settings, devices, choose_batch_size(env))
        state = jax.jit(trainer.init)(jax.random.key(0))
        update = jax.jit(trainer.update).lower(state).compile()
        for iteration in range(num_iterations):
            state, _ = jax.block_until_ready(update(state))
            if (iteration + 1) % 10 == 0 or iteration + 1 == num_iterations:
                jax.effects_barrier()
                packed, plain = (totals["live"] / totals[name] for name in ("slots", "plain"))
                print(
                    f"{iteration + 1} iterations: {totals['live']:,} live steps, utilization "
                    f"{packed:.3f}; without refilling {plain:.3f}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
