import pytest

from ailsrs_jax.envs.registry import TASKS
from ailsrs_jax.trainers.algorithms import ALGORITHMS, preset_settings
from ailsrs_jax.trainers.parts.settings import validate


def test_paper_preset_is_table_one() -> None:
    settings = preset_settings("Hopper-v5", "paper")
    assert settings.step_size == settings.final_step_size == 0.02
    assert settings.num_directions == settings.num_top_directions == 320
    assert settings.noise_std == 0.03
    assert settings.episode_length == 1000
    assert settings.num_iterations == 100_000
    assert settings.discriminator_learning_rate == 0.00025
    assert settings.discriminator_batch_size == 1000
    assert settings.discriminator_steps == 3
    assert settings.gradient_penalty == 0.0
    assert settings.memory_iterations == 1
    assert settings.standardize_with == "running"
    assert settings.reward_after_end == 1.0


def test_only_half_cheetah_starts_from_behavior_cloning_in_the_paper() -> None:
    starts = {env_id: preset_settings(env_id, "paper").behavior_cloning_start for env_id in TASKS}
    assert [env_id for env_id in TASKS if starts[env_id]] == ["HalfCheetah-v5"]


@pytest.mark.parametrize("env_id", TASKS)
def test_every_task_has_every_preset(env_id: str) -> None:
    for preset in ("tuned", "paper"):
        for algorithm in ALGORITHMS:
            validate(preset_settings(env_id, preset, algorithm))
