"""Settings that are known to work, by task."""

from ailsrs_jax.errors import UserError
from ailsrs_jax.trainers.ailsrs import AilsrsSettings
from ailsrs_jax.trainers.ars import ArsSettings

PRESETS = ("tuned", "paper")

# Table I of the paper, all directions; only HalfCheetah starts from behaviour cloning there.
_PAPER = {
    "HalfCheetah-v5": AilsrsSettings(behavior_cloning_start=True),
    "Hopper-v5": AilsrsSettings(),
    "Swimmer-v5": AilsrsSettings(),
    "Walker2d-v5": AilsrsSettings(),
}

_TUNED_BASE = AilsrsSettings(
    num_iterations=100,
    num_directions=32,
    num_top_directions=16,
    step_size=0.03,
    final_step_size=0.03,
    discriminator_learning_rate=5e-4,
    gradient_penalty=10.0,
    memory_iterations=10,
    behavior_cloning_start=True,
)
_TUNED = {
    "HalfCheetah-v5": _TUNED_BASE,
    "Hopper-v5": _TUNED_BASE,
    "Swimmer-v5": _TUNED_BASE,
    "Walker2d-v5": _TUNED_BASE,
}

# Augmented random search on the environment's reward, after the settings of its paper.
EXPERTS = {
    "HalfCheetah-v5": ArsSettings(num_iterations=200),
    "Hopper-v5": ArsSettings(num_directions=8, step_size=0.01, noise_std=0.025, survival_bonus=1.0),
    "Swimmer-v5": ArsSettings(num_directions=8, noise_std=0.02),
    "Walker2d-v5": ArsSettings(
        num_directions=40, num_top_directions=30, noise_std=0.025, survival_bonus=1.0
    ),
}


def preset_settings(env_id: str, preset: str) -> AilsrsSettings:
    """The settings of ``preset`` for the task.

    Raises:
        UserError: there is no such preset.
    """
    if preset not in PRESETS:
        raise UserError(f"unknown preset '{preset}': use {' or '.join(PRESETS)}")
    return (_TUNED if preset == "tuned" else _PAPER)[env_id]
