"""Settings as Python hands them in, and as the command line writes them."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ailsrs_jax.errors import UserError
from ailsrs_jax.trainers.ars import ArsSettings
from ailsrs_jax.trainers.parts.ailsrs_settings import AilsrsSettings
from ailsrs_jax.trainers.parts.settings import as_text, override, parse, validate

GOOD: list[Any] = [
    AilsrsSettings(reward_after_end=0, gradient_penalty=10),
    AilsrsSettings(step_size=np.float32(0.1), noise_std=jnp.array(0.1)),  # type: ignore[arg-type]
    AilsrsSettings(num_directions=np.int64(320)),  # type: ignore[arg-type]
    ArsSettings(survival_bonus=-1),
]

WRONG: dict[str, dict[str, Any]] = {
    "num_directions is 0: it must be at least 1": {"num_directions": 0},
    "num_directions is 320.0: it must be a whole number": {"num_directions": 320.0},
    "episode_length is True: it must be a whole number": {"episode_length": True},
    "it must be below 2^31": {"num_iterations": 10**30},
    "0: it must be a number": {"step_size": 10**400},
    "behavior_cloning_start is 1: it must be true or false": {"behavior_cloning_start": 1},
    "standardize_with is Expert: it must be running or expert": {"standardize_with": "Expert"},
    "step_size is 0: it must be positive": {"step_size": 0},
    "step_size is 0.02: it must be a number": {"step_size": "0.02"},
    "it must be a number": {"step_size": [0.02, 0.03]},
    "step_size is [[1], [1, 2]]: it must be a number": {"step_size": [[1], [1, 2]]},
    "gradient_penalty is inf: it must be finite": {"gradient_penalty": np.inf},
    "gradient_penalty is -1: it must not be negative": {"gradient_penalty": -1},
    "keep_within is 0.5: it must be at least 1": {"keep_within": 0.5},
    "reward_after_end is 2: it must be at most 1": {"reward_after_end": 2},
}


@pytest.mark.parametrize("settings", GOOD)
def test_what_makes_sense(settings: Any) -> None:
    validate(settings)


@pytest.mark.parametrize(("message", "change"), WRONG.items())
def test_what_makes_none(message: str, change: dict[str, Any]) -> None:
    with pytest.raises(UserError) as caught:
        validate(dataclasses.replace(AilsrsSettings(), **change))
    assert message in str(caught.value)


def test_traced_ones_may_be_anything() -> None:
    def make(number: jax.Array) -> jax.Array:
        settings = dataclasses.replace(
            AilsrsSettings(standardize_with="expert"), step_size=number, recentre_beyond=number
        )
        validate(settings)
        settings.require_consistent()
        return number

    jax.jit(make)(-1.0)


def test_text_becomes_the_type_of_the_field() -> None:
    texts = {"num_iterations": "3", "step_size": "1", "behavior_cloning_start": "True"}
    parsed = parse(AilsrsSettings(), texts)
    assert parsed == {"num_iterations": 3, "step_size": 1.0, "behavior_cloning_start": True}
    assert list(map(type, parsed.values())) == [int, float, bool]
    assert parse(AilsrsSettings(), {n: as_text(v) for n, v in parsed.items()}) == parsed
    with pytest.raises(UserError, match=r"num_iterations is '3\.5': it must be a whole number"):
        parse(AilsrsSettings(), {"num_iterations": "3.5"})
    with pytest.raises(UserError, match=r"no setting 'step' \(did you mean step_size"):
        parse(AilsrsSettings(), {"step": "1"})


def test_typed_values_are_plain_python_ones() -> None:
    changes = {"step_size": 1, "num_iterations": np.int32(3), "noise_std": jnp.array(0.5)}
    settings = override(AilsrsSettings(), changes)
    assert (settings.step_size, settings.num_iterations, settings.noise_std) == (1.0, 3, 0.5)
    assert [type(getattr(settings, name)) for name in changes] == [float, int, float]
    with pytest.raises(UserError, match="no setting 'noise'"):
        override(AilsrsSettings(), {"noise": 0.1})
    with pytest.raises(UserError, match=r"step_size is 0\.02: it must be a number"):
        override(AilsrsSettings(), {"step_size": "0.02"})
