"""Measure the share of live steps among MJX's simulated steps, on a task that ends early.

usage: python experiments/packing.py [ENV] [ITERATIONS]    (hopper, 50; N = 320, T = 1000)

It trains with the paper's preset, from zero weights, and compares the steps of the slots with those
of a simulation without refilled slots, where every episode takes as long as the longest of its
device.
"""

import dataclasses
import sys
from typing import Any

import jax
import numpy as np

from ailsrs_jax.envs.registry import make_env, resolve_env_id
from ailsrs_jax.runs.demonstrate import expert_demonstrations
from ailsrs_jax.runs.devices import choose_simulator, set_up_jax
from ailsrs_jax.trainers.ailsrs import make_ailsrs
from ailsrs_jax.trainers.algorithms import preset_settings
from ailsrs_jax.trainers.parts.episodes import Episodes
from ailsrs_jax.trainers.parts.rollout import Simulator

TOTALS = {"live": 0, "slots": 0, "plain": 0}


@dataclasses.dataclass(frozen=True)
class CountingSimulator(Simulator):
    """Adds the steps of all episodes to ``TOTALS``."""

    def __call__(self, *arguments: Any, **options: Any) -> Episodes:
        """Simulate and count."""
        episodes = super().__call__(*arguments, **options)
        jax.debug.callback(self._count, episodes.lengths, episodes.slot_steps)
        return episodes

    def _count(self, lengths: np.ndarray, slot_steps: np.ndarray) -> None:
        shares = np.array_split(lengths, self.num_devices)
        TOTALS["live"] += int(lengths.sum())
        TOTALS["slots"] += int(slot_steps)
        TOTALS["plain"] += sum(int(share.max()) * len(share) for share in shares)


def main() -> None:
    """Print the shares of live steps every ten iterations."""
    set_up_jax()
    env_id = resolve_env_id(sys.argv[1] if len(sys.argv) > 1 else "hopper")
    num_iterations = int(sys.argv[2]) if len(sys.argv) > 2 else 50
    simulator = CountingSimulator(**vars(choose_simulator(make_env(env_id, "mjx"))))
    demonstrations = expert_demonstrations(env_id, 10, "mujoco")
    trainer = make_ailsrs(simulator, demonstrations, preset_settings(env_id, "paper"))
    place = simulator.everywhere
    state = jax.jit(trainer.init, out_shardings=place)(jax.random.key(0))
    update = jax.jit(trainer.update, out_shardings=place).lower(state).compile()
    for iteration in range(num_iterations):
        state, _ = jax.block_until_ready(update(state))
        if (iteration + 1) % 10 == 0 or iteration + 1 == num_iterations:
            jax.effects_barrier()
            packed, plain = (TOTALS["live"] / TOTALS[name] for name in ("slots", "plain"))
            print(
                f"{iteration + 1} iterations: {TOTALS['live']:,} live steps, utilization "
                f"{packed:.3f}; without refilling {plain:.3f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
