"""The whole loop in environments of Gymnasium: demonstrate, train, resume, evaluate, show."""

import contextlib
import json
import os
import random
import signal
import threading
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

import ailsrs_jax as ail
from ailsrs_jax.envs import registry
from ailsrs_jax.errors import UserError
from ailsrs_jax.runs.evaluation import evaluation_episodes
from ailsrs_jax.runs.storage.metrics import IterationReport
from tests.cli.test_cli import ailsrs
from tests.workers.environments import Mass, happens_first
from tests.workers.test_pool import children, make

SMALL = {
    "num_iterations": 3,
    "num_directions": 4,
    "num_top_directions": 2,
    "num_evaluation_episodes": 2,
    "discriminator_steps": 2,
    "discriminator_batch_size": 32,
    "memory_samples": 16,
    "num_distance_samples": 50,
    "leave_out_beyond": 0.0,
    "episode_length": 30,
}
ARS = {
    "algorithm": "ars",
    "num_iterations": 2,
    "num_directions": 4,
    "num_top_directions": 2,
    "episode_length": 30,
}
SETTINGS = ["--set", *(f"{name}={value}" for name, value in SMALL.items())]
PENDULUM = "gymnasium:Pendulum-v1"
MASS = make("Mass")  # each call makes another environment with its own workers
CONTROLLER = """
import numpy as np

def swing(observation):
    cosine, sine, speed = observation
    return np.array([-5 * sine - 2 * speed if cosine > 0 else np.sign(speed) * 2])
"""


def test_the_whole_loop(in_tmp_path: Path, monkeypatch, capsys) -> None:
    Path("controllers.py").write_text(CONTROLLER)
    expert = ["--expert", "controllers:swing", "--num-trajectories", "3"]
    demonstrate = ["demonstrate", PENDULUM, *expert, "--output", "swing.npz"]
    assert ailsrs(monkeypatch, *demonstrate) == 0
    demonstrations = ail.load_demonstrations("swing.npz")
    assert demonstrations.env_id == PENDULUM
    assert demonstrations.observations.shape == (3, 200, 3)  # the environment's time limit
    train = ["train", PENDULUM, "--demonstrations", "swing.npz", "--workers", "2", *SETTINGS]
    workers = Mock(wraps=registry._make_gymnasium)
    with monkeypatch.context() as patched:
        patched.setattr(registry, "_make_gymnasium", workers)
        assert ailsrs(monkeypatch, *train, "--output", "run") == 0
    assert {call.args[1] for call in workers.call_args_list} == {"2"}  # to evaluate, too
    policy = ail.load_policy("run/seed_0/policy.npz")
    starts = evaluation_episodes(policy, 3, "gymnasium", episode_length=30).observations[:, 0]
    assert not np.isin(demonstrations.observations[:, 0, 2], starts[:, 2]).any()
    capsys.readouterr()
    assert ailsrs(monkeypatch, "evaluate", "run", "--episodes", "3", "--json") == 0
    (row,) = json.loads(capsys.readouterr().out)["policies"]
    assert (row["env_id"], row["physics"], row["length_mean"]) == (PENDULUM, "gymnasium", 30)
    assert row["return_mean"] == pytest.approx(ail.evaluate(policy, 3, episode_length=30).mean)
    assert ailsrs(monkeypatch, "report", "run", "--episodes", "2") == 0
    assert "Not measured" not in Path("run/report.html").read_text()
    assert ailsrs(monkeypatch, "train", PENDULUM, "--workers", "0") == 2
    assert "workers is '0'" in capsys.readouterr().err
    assert ailsrs(monkeypatch, "train", "hopper", "--workers", "2") == 2
    assert "workers is for environments named gymnasium:ID" in capsys.readouterr().err


def mass_demonstrations() -> ail.Demonstrations:
    return ail.demonstrate(
        lambda observation: -observation[:1] - 1.5 * observation[1:],
        4,
        env=MASS,
        episode_length=30,
    )


def test_a_function_that_makes_the_environment() -> None:
    demonstrations = mass_demonstrations()
    assert demonstrations.env_id == "gymnasium:Mass"
    for algorithm, settings in (("bc", {"episode_length": 30}), ("ailsrs", SMALL)):
        run = ail.train(MASS, demonstrations, algorithm=algorithm, **settings)
        assert ail.evaluate(run.policies[0], 3, env=MASS, episode_length=30).mean > 5
    run = ail.train(MASS, **ARS)
    assert run.policies[0].weights.shape == (1, 2)


def test_gail_learns_in_workers_and_goes_on(tmp_path: Path) -> None:
    settings = {
        "num_iterations": 2,
        "updates_per_iteration": 2,
        "batch_size": 256,
        "behavior_cloning_steps": 300,
        "num_distance_samples": 50,
        "episode_length": 30,
    }
    given = {"algorithm": "gail", "workers": 2, **settings}
    run = ail.train(MASS, mass_demonstrations(), **given)
    assert ail.evaluate(run.policies[0], 3, env=MASS, episode_length=30).mean > 10

    def stop(report: IterationReport) -> None:
        raise KeyboardInterrupt

    given["output"] = tmp_path / "run"  # its episodes go on where they were
    with pytest.raises(KeyboardInterrupt):
        ail.train(MASS, mass_demonstrations(), watch=stop, checkpoint_every=1, **given)
    again = ail.train(MASS, mass_demonstrations(), resume=True, **given)
    for one, other in zip(again.policies[0].weights, run.policies[0].weights, strict=True):
        np.testing.assert_array_equal(one, other)


def test_what_steps_all_together_is_refused() -> None:
    with pytest.raises(UserError, match=r"ppo steps all environments together.*: use ars"):
        ail.train_expert(PENDULUM)


class Fragile(Mass):
    """Raises an exception once, after four iterations of a training."""

    def step(self, action: np.ndarray) -> Any:
        if Path(os.environ["MARKS"], "four").exists() and happens_first(1):
            raise OSError("the simulator has lost its licence")
        return super().step(action)


def test_an_exception_leaves_a_run_that_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MARKS", str(tmp_path))

    def fragile() -> Fragile:
        return Fragile()

    def mark(report: IterationReport) -> None:
        if report.iteration == 3:
            (tmp_path / "four").touch()

    options = ARS | {"seeds": [3], "num_iterations": 12}
    with pytest.raises(UserError, match="OSError: the simulator has lost its licence; the tra"):
        ail.train(fragile, output=tmp_path / "a", watch=mark, **options)
    assert (tmp_path / "a" / "checkpoints" / "4").exists()
    run = ail.train(fragile, output=tmp_path / "a", resume=True, **options)
    again = ail.train(fragile, **options)
    np.testing.assert_array_equal(run.policies[3].weights, again.policies[3].weights)


@pytest.mark.slow
def test_killed_workers_change_nothing() -> None:
    demonstrations, number = mass_demonstrations(), 0
    options = SMALL | {"num_iterations": 60, "num_directions": 16}
    undisturbed = ail.train(make("Mass"), demonstrations, **options)
    over = threading.Event()

    def kill() -> None:
        nonlocal number
        while not over.wait(0.3):
            if workers := children(os.getpid()):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(random.choice(workers), signal.SIGKILL)
                    number += 1

    killer = threading.Thread(target=kill)
    killer.start()
    disturbed = ail.train(make("Mass"), demonstrations, workers=3, **options)
    over.set()
    killer.join()
    assert number >= 20
    np.testing.assert_array_equal(undisturbed.policies[0].weights, disturbed.policies[0].weights)
