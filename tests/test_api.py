"""What ``import ailsrs_jax`` offers: names, their types, and the examples of their docstrings."""

import ast
import doctest
import inspect
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import ailsrs_jax

# Those without an example: types that others return, settings, and formats that need a package.
WITHOUT_EXAMPLE = {
    *("Ailsrs", "Ars", "BehaviorCloning", "Gail", "Trpo", "MujocoTask", "UserError"),
    *("AilsrsSettings", "ArsSettings", "BehaviorCloningSettings", "EvolutionSettings"),
    *("GailSettings", "PpoSettings", "TrpoSettings"),
    *("Algorithm", "Simulator", "Trainer"),
    *("Demonstrations", "Evaluation", "IterationReport", "Recording", "Result"),
    *("SavedLinearPolicy", "SavedMlpPolicy"),
    *("load_imitation", "load_minari", "save_minari", "merge_sweeps", "report_sweep"),
    *("Animation", "render", "report"),
    *("make_ars", "make_behavior_cloning", "make_gail", "make_trpo", "record"),
    *("load_demonstrations", "save_demonstrations"),  # in the example of demonstrate
}
SLOW = {"make_ailsrs", "sweep", "train"}  # to compile
WITH_EXAMPLE = [
    pytest.param(name, marks=[pytest.mark.slow] if name in SLOW else [])
    for name in ailsrs_jax.__all__
    if name not in WITHOUT_EXAMPLE
]


def examples(name: str) -> list[doctest.DocTest]:
    """Of a public name, and of its methods."""
    value = getattr(ailsrs_jax, name)
    found = doctest.DocTestFinder().find(value, name, module=inspect.getmodule(value), globs={})
    return [test for test in found if test.examples]


@pytest.mark.parametrize("name", WITH_EXAMPLE)
def test_examples_of_docstrings(name: str, in_tmp_path: Path) -> None:
    tests = examples(name)
    assert tests, f"{name} has no example"
    for test in tests:
        printed: list[str] = []
        flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
        doctest.DocTestRunner(optionflags=flags).run(test, out=printed.append)
        assert not printed, "".join(printed)


def test_nothing_else_has_an_example() -> None:
    assert not [name for name in WITHOUT_EXAMPLE if examples(name)]


@pytest.mark.parametrize(
    ("call", "problem"),
    [
        (lambda: ailsrs_jax.evaluate("policy.npz", 2), "no policy: 'policy.npz'; load_policy"),
        (lambda: ailsrs_jax.evaluate(ailsrs_jax.load_expert("swimmer"), 2.0), "2.0 episodes asked"),
        (lambda: ailsrs_jax.train("swimmer", algorithm=3), "name the algorithm"),
        (lambda: ailsrs_jax.train("swimmer", states_only="no"), "must be True or False"),
    ],
)
def test_wrong_arguments_are_one_line(call: Callable[[], object], problem: str) -> None:
    with pytest.raises(ailsrs_jax.UserError, match=problem):
        call()


@pytest.mark.parametrize("name", ailsrs_jax.__all__)
def test_every_public_name_is_documented(name: str) -> None:
    documented = getattr(ailsrs_jax, name)
    assert len(inspect.getdoc(documented)) > 10
    assert not inspect.getdoc(documented).startswith(f"{name}(")  # as dataclasses' own would


def test_the_names_are_listed() -> None:
    assert set(ailsrs_jax.__all__) <= set(dir(ailsrs_jax))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = ailsrs_jax.nothing


def test_type_checkers_and_python_find_the_same() -> None:
    checked = {}
    for node in ast.walk(ast.parse(Path(ailsrs_jax.__file__).read_text())):
        if isinstance(node, ast.ImportFrom) and node.module.startswith("ailsrs_jax."):
            checked |= {
                alias.asname: node.module.removeprefix("ailsrs_jax.")
                for alias in node.names
                if alias.asname is not None  # what is exported
            }
    assert checked == ailsrs_jax._HOMES
    assert (Path(ailsrs_jax.__file__).parent / "py.typed").exists()


def test_a_policy_acts_without_jax() -> None:
    """To import the package takes nothing, and to drive a robot no more than NumPy."""
    program = """
import sys
import ailsrs_jax as ail

dir(ail)
assert not {"numpy", "jax", "mujoco", "brax"} & set(sys.modules)
from ailsrs_jax.data.policies import expert_path
policy = ail.load_policy(expert_path("Hopper-v5"))
assert policy([0.0] * 11).shape == (3,)
assert not {"jax", "mujoco", "brax", "gymnasium", "onnx", "safetensors"} & set(sys.modules)
"""
    subprocess.run([sys.executable, "-c", program], check=True)


SCRIPT = """
from pathlib import Path

import jax
import numpy as np
from typing import assert_type

import ailsrs_jax as ail


def tell(report: ail.IterationReport) -> None:
    print(report.iteration, report.metrics["evaluation_return"])


run = ail.train("hopper", num_trajectories=10, seeds=[0, 1], watch=tell, num_iterations=3)
assert_type(run, ail.Result)
policy = run.policies[0]
assert_type(policy, ail.SavedPolicy)
assert_type(policy(np.zeros(11)), np.ndarray)
assert_type(ail.evaluate(policy).mean, float)
policy.save(Path("policy.onnx"))
assert_type(ail.load_policy("policy.npz"), ail.SavedPolicy)
demonstrations = ail.demonstrate(ail.load_expert("hopper"), 2)
assert_type(demonstrations, ail.Demonstrations)
ail.export("runs/hopper", "hopper", license_id="mit")
env = ail.make_env("hopper", "mjx")
trainer = ail.make_ailsrs(env, demonstrations, ail.AilsrsSettings(num_iterations=2))
state, metrics = jax.jit(trainer.train)(jax.random.key(0))
rows = ail.sweep({"env": "swimmer"}, "runs/sweep", shard=(0, 2))
ail.report_sweep(Path("runs/sweep"))
"""
WRONG = {
    "ail.trian('hopper')": "has no attribute",
    "ail.train('hopper', resume='yes')": "incompatible type",
    "ail.evaluate('policy.npz')": "incompatible type",
    "ail.AilsrsSettings(noise=1)": "Unexpected keyword",
}


@pytest.mark.slow
def test_a_typed_script(tmp_path: Path) -> None:
    def check(name: str, program: str) -> str:
        (tmp_path / name).write_text(program)
        command = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", "cache", name]
        command += ["--python-executable", sys.executable]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True).stdout

    assert "Success: no issues found" in check("right.py", SCRIPT)
    program = "import ailsrs_jax as ail\n" + "".join(f"{line}\n" for line in WRONG)
    errors = check("wrong.py", program)
    for number, message in enumerate(WRONG.values(), 2):
        assert any(
            line.startswith(f"wrong.py:{number}: error:") and message in line
            for line in errors.splitlines()
        ), errors
