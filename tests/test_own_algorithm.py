"""The example of docs/your_own_algorithm.md, and mistakes in such a file."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest

import ailsrs_jax as ail
from ailsrs_jax.cli.main import main
from ailsrs_jax.sweeps.spec import expand
from ailsrs_jax.trainers.algorithms import find_algorithm
from tests.point_mass import PointMass
from tests.sweeps.toy_sweep import POINT_MASS, TINY

PAGE = Path(__file__).parents[1] / "docs" / "your_own_algorithm.md"
EXAMPLE = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)[0]
NAME = "my_file:my_algorithm"
SMALL = TINY | {"num_directions": 2, "num_top_directions": 1}  # p n = 2 orthogonal directions


@pytest.fixture
def my_file(in_tmp_path: Path, point_mass_expert: ail.Demonstrations) -> Path:
    path = in_tmp_path / "my_file.py"
    path.write_text(EXAMPLE)
    ail.save_demonstrations(point_mass_expert.replace(env_id=POINT_MASS), "point_mass.npz")
    return path


def test_the_example_is_short_and_uses_public_names() -> None:
    code = [line for line in EXAMPLE.splitlines() if line.strip()]
    assert len(code) <= 35
    assert "ailsrs_jax." not in EXAMPLE
    assert set(re.findall(r"ail\.(\w+)", EXAMPLE)) <= set(ail.__all__)


def test_it_trains_resumes_and_reports(my_file: Path) -> None:
    arguments = {"algorithm": NAME, "output": "run", "num_iterations": 4, "weight_decay": 0.1}
    calls: list[int] = []

    def interrupt(report: ail.IterationReport) -> None:
        calls.append(report.iteration)
        if len(calls) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        ail.train(
            POINT_MASS, "point_mass.npz", checkpoint_every=1, watch=interrupt, **SMALL | arguments
        )
    resumed = ail.train(POINT_MASS, "point_mass.npz", resume=True, **SMALL | arguments)
    whole = ail.train(POINT_MASS, "point_mass.npz", **SMALL | arguments | {"output": None})
    np.testing.assert_array_equal(resumed.policies[0].weights, whole.policies[0].weights)
    assert f"{NAME} on {POINT_MASS}" in ail.report("run", episodes=2, video=False).read_text()


def test_its_directions_are_orthogonal_and_its_weights_decay(my_file: Path) -> None:
    import jax

    algorithm = find_algorithm(NAME)
    settings = algorithm.settings(**SMALL)
    trainer = algorithm.make(PointMass(), ail.load_demonstrations("point_mass.npz"), settings)
    deltas = trainer.ask(jax.random.key(0))
    assert deltas.shape == (2, 1, 3)
    assert abs(float(deltas[0, 0] @ deltas[1, 0])) < 1e-5
    state = trainer.init(jax.random.key(0)).replace(weights=np.ones((1, 3), np.float32))
    still = trainer.tell(state, deltas, np.zeros((2, 2), np.float32))
    np.testing.assert_allclose(still, 0.999)


@pytest.mark.slow
def test_it_is_in_a_sweep(my_file: Path) -> None:
    grid = {"algorithm": NAME, "settings": {"weight_decay": [0.0, 0.1]}}
    spec = {
        "env": POINT_MASS,
        "demonstrations": "point_mass.npz",
        "episodes": 2,
        "settings": SMALL,
        "grid": [grid],
    }
    cells = expand(spec | {"seeds": [0, 1]}).cells
    # Nobody knows what its trainer makes of settings, so only seeds are trained together.
    assert [cell.program == cells[0].program for cell in cells] == [True, True, False, False]
    drawn = expand(spec | {"seeds": [0, 1], "num_trajectories": 1, "draw_from": 2}).cells
    assert len({cell.program for cell in drawn}) == 4
    rows = ail.sweep(spec, "sweep")
    assert [row["status"] for row in rows] == ["done", "done"]
    assert rows[0]["label"] == "My AILSRS"


MISTAKES = {
    # what is replaced in the example, by what, and what the line says
    "a typo in an attribute": (
        "my_algorithm =",
        "my_algorithn =",
        "there is no 'my_algorithm' (did you mean my_algorithn",
    ),
    "a syntax error": ("def make(", "def make((", "SyntaxError"),
    "an exception as it is imported": ("import ailsrs_jax as ail", "1 / 0", "ZeroDivisionError"),
    "a wrong signature": ("def make(simulator, ", "def make(", "TypeError: make() takes 2"),
    "an exception in a method": ("flat = deltas.", "flat = deltaz.", "NameError: name 'deltaz'"),
    "something else than an algorithm": (
        "my_algorithm =",
        "my_algorithm = 3\nother =",
        "is of type int",
    ),
    "a wrong shape": ("* weights", "* weights[:1, :1]", "must have equal types"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_line(
    mistake: str, my_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    old, new, message = MISTAKES[mistake]
    assert old in EXAMPLE
    my_file.write_text(EXAMPLE.replace(old, new, 1))
    settings = [f"{name}={value}" for name, value in SMALL.items()]
    command = ["train", POINT_MASS, "--demonstrations", "point_mass.npz", "--algorithm", NAME]
    monkeypatch.setattr(sys, "argv", ["ailsrs", *command, "--output", "run", "--set", *settings])
    with pytest.raises(SystemExit) as caught:
        main()
    assert caught.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert message in line
    if mistake != "something else than an algorithm":
        assert re.search(r"my_file\.py, line \d+", line)
    if log := re.search(r"the traceback is in (\S+\.log)", line):
        assert "Traceback" in Path(log[1]).read_text()
    assert not Path("run").exists()


@pytest.mark.parametrize("make", ["MyAilsrs", "functools.partial(make, 1)"])
def test_what_makes_the_trainer_need_not_be_a_function(make: str, my_file: Path) -> None:
    text = EXAMPLE.replace("import dataclasses", "import dataclasses\nimport functools")
    my_file.write_text(text.replace("make=make,", f"make={make},"))
    with pytest.raises(ail.UserError, match=r"my_file\.py, line \d+: \w+Error: "):
        ail.train(POINT_MASS, "point_mass.npz", algorithm=NAME, **SMALL)


def test_a_reward_and_a_loss_of_ones_own(my_file: Path) -> None:
    my_file.write_text(
        "def reward(logits):\n    return 2.0 * logits\n\n"
        "def loss(policy, expert):\n    return (policy + 1) ** 2 + (expert - 1) ** 2\n\n"
        "def wrong(logits):\n    return logits.missing\n"
    )
    own = {"imitation_reward": "my_file:reward", "discriminator_loss": "my_file:loss"}
    run = ail.train(POINT_MASS, "point_mass.npz", **SMALL | own)
    assert np.isfinite(run.policies[0].weights).all()
    with pytest.raises(ail.UserError, match=r"my_file\.py, line 8: AttributeError"):
        ail.train(POINT_MASS, "point_mass.npz", **SMALL | {"imitation_reward": "my_file:wrong"})
    with pytest.raises(ail.UserError, match="it must be gail, airl, amp or a function"):
        ail.train(POINT_MASS, "point_mass.npz", **SMALL | {"imitation_reward": "gial"})
