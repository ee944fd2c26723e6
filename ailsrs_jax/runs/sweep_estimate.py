"""What a cell of a sweep will cost, before it runs."""

from ailsrs_jax.runs.algorithms import find_algorithm
from ailsrs_jax.runs.presets import preset_settings
from ailsrs_jax.runs.sweep_spec import Cell
from ailsrs_jax.trainers.settings import override


def estimated_env_steps(cell: Cell) -> int:
    """Environment steps that training simulates at most: episodes may end early, and runs too."""
    preset = preset_settings(cell.env_id, cell.preset, cell.algorithm)
    settings = override(preset, cell.settings)
    num_episodes = settings.num_evaluation_episodes
    batches = 0
    if find_algorithm(cell.algorithm).searches:
        num_episodes += 2 * settings.num_directions
    elif hasattr(settings, "updates_per_iteration"):  # by trust region
        num_episodes *= 2  # of the mean, and of drawn actions
        updates = settings.updates_per_iteration * getattr(settings, "policy_steps", 1)
        batches = updates * settings.batch_size
    return int(settings.num_iterations * (num_episodes * settings.episode_length + batches))
