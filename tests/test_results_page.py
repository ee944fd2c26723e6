"""The rules and verdicts of experiments/RESULTS.md, and claims that are not yet run."""

import dataclasses
import json
import subprocess
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ailsrs_jax.errors import UserError
from ailsrs_jax.sweeps.cells import Cell
from tests.sweeps.synthetic_sweep import HARD_TASKS, TASKS, row, write_sweep

pytest.importorskip("experiments.results", reason="the package is installed without them")
from experiments import results
from experiments.claims import CLAIMS
from experiments.evidence import (
    ABLATIONS,
    CHEETAH,
    FIGURE_2,
    HOPPER,
    NUM_SEEDS,
    NUMBERS,
    PAPER_EXPERTS,
    SWIMMER,
    TABLE_1,
    WALKER,
    Check,
    Claim,
    Evidence,
    Finding,
    judge,
)

Score = Callable[[str, str, int], tuple[float, float]]  # label, task, number: mean, spread


def write_figure_2(directory: Path, score: Score, seconds: dict[str, float], expert: float) -> None:
    rows = []
    for label in ("BC", "GAIL", "AILSRS"):
        for task in TASKS:
            for number in NUMBERS:
                mean, spread = score(label, task, number)
                for seed in range(3):
                    changes: dict[str, Any] = {
                        "expert_return": expert * PAPER_EXPERTS[task],
                        "steps_to_90": int(1000 * seconds[label]),
                        "seconds": seconds[label],
                    }
                    where = {"label": label, "env_id": task, "num_trajectories": number}
                    rows.append(row(mean + spread * (seed - 1), **where, seed=seed, **changes))
    write_sweep(directory / "paper", rows)


def write_curves(directory: Path, curves: dict[str, list[list[float]]]) -> None:
    rows = [
        row(curve[-1], env_id=task, seed=seed, curve=curve)
        for task, mine in curves.items()
        for seed, curve in enumerate(mine)
    ]
    write_sweep(directory / "curves", rows)


def write_ablations(
    directory: Path, steps: dict[str, int], curves: dict[str, list[float]], zero: float
) -> None:
    """Write the ablations, and with the score ``zero`` the runs of Table I, from zero weights."""
    rows = []
    for label in ("tuned", "from zero", "cross entropy"):
        curve = curves.get(label, [0, 1])
        for task in (HOPPER, CHEETAH):
            random, expert = TASKS[task]
            changes: dict[str, Any] = {
                "algorithm": "ailsrs",
                "steps_to_90": steps.get(label, ""),
                "mean_return_over_training": random + sum(curve) / len(curve) * (expert - random),
                "curve": curve,
            }
            seeds = range(NUM_SEEDS[ABLATIONS])
            rows += [row(1.0, label=label, env_id=task, seed=s, **changes) for s in seeds]
    write_sweep(directory / "ablations", rows)
    of_paper = {"label": "Table I", "algorithm": "ailsrs", "env_id": HOPPER}
    write_sweep(
        directory / "table_1", [row(zero, seed=s, **of_paper) for s in range(NUM_SEEDS[TABLE_1])]
    )


def write_hard(directory: Path, score: float) -> None:
    rows = [row(score, env_id=task, seed=seed) for task in HARD_TASKS for seed in range(3)]
    write_sweep(directory / "ant_humanoid", rows)


CLONED = {  # the returns in the paper, and values between them where it gives none
    CHEETAH: ((1000, 2500, 3500, 4120), 100),
    HOPPER: ((1200, 2200, 2900, 3224), 15),
    WALKER: ((863, 870, 891, 880), 31),
    SWIMMER: ((353, 353, 354, 354), 9),
}


def as_the_paper_says(directory: Path) -> None:
    def score(label: str, task: str, number: int) -> tuple[float, float]:
        easy = task in (WALKER, SWIMMER)
        if label == "BC":
            returns, std = CLONED[task]
            random, expert = TASKS[task][0], PAPER_EXPERTS[task]
            mean = returns[NUMBERS.index(number)]
            return (mean - random) / (expert - random), std / (expert - random)
        if label == "GAIL":
            better = task == CHEETAH and number > 10
            return (1.0 if easy else 1.001 if better else 0.98), 0.003
        return (1.002 if easy else 1.0), 0.001

    write_figure_2(directory, score, {"BC": 1, "GAIL": 500, "AILSRS": 50}, expert=1)
    level = [0.0, 1.0, 1.0, 1.0]
    worse = [0.0, 0.9, 0.5, 0.9]
    write_curves(
        directory,
        {
            CHEETAH: [level] * 3 + [worse] * 2,
            HOPPER: [level] * 3 + [[0.0, 0.7, 0.7, 0.7]] * 2,
            WALKER: [level] * 5,
            SWIMMER: [level] * 5,
        },
    )
    write_ablations(
        directory,
        {"tuned": 300, "from zero": 900},
        {"tuned": level, "cross entropy": worse},
        zero=1,
    )
    write_hard(directory, 0.3)


def the_contrary(directory: Path) -> None:
    def score(label: str, task: str, number: int) -> tuple[float, float]:
        easy = task in (WALKER, SWIMMER)
        if label == "BC":
            start = {CHEETAH: 1.3, HOPPER: 1.3, WALKER: 1.3, SWIMMER: 0.6}[task]
            slope = 0.03 if task == HOPPER else 0.01
            return start - slope * (number - 10), 0.003 if task == HOPPER else 0.001
        if label == "GAIL":
            return 0.4 - 0.1 * easy, 0.05
        return 0.1 + 0.005 * number - 0.1 * easy, 0.1

    write_figure_2(directory, score, {"BC": 1, "GAIL": 50, "AILSRS": 500}, expert=1.5)
    low, lower = [0.0, 0.5, 0.5, 0.5], [0.0, 0.5, 0.3, 0.3]
    write_curves(
        directory,
        {
            CHEETAH: [lower] + [low] * 4,
            HOPPER: [lower] * 3 + [low] * 2,
            WALKER: [low] * 5,
            SWIMMER: [low] * 5,
        },
    )
    write_ablations(
        directory, {"tuned": 900, "from zero": 300}, {"tuned": lower, "cross entropy": low}, zero=0
    )
    write_hard(directory, 1.0)


def verdicts(directory: Path) -> dict[str, str]:
    evidence = Evidence(results.read_all(directory))
    return {
        f"{section}: {claim.text}": judge(claim, evidence).verdict
        for section, claims in CLAIMS.items()
        for claim in claims
    }


def test_results_that_agree_with_the_paper_reproduce_it(tmp_path: Path) -> None:
    as_the_paper_says(tmp_path)
    found = verdicts(tmp_path)
    assert len(found) == sum(map(len, CLAIMS.values())) == 52  # no two have the same text
    contradictions = {  # the paper contradicts itself
        "BC succeeds only with large amounts": "partly",  # BC also does well with few on Swimmer
        "Static, linear policies achieve": "partly",  # not on Ant and Humanoid
    }
    for claim, verdict in found.items():
        expected = [v for text, v in contradictions.items() if text in claim] or ["reproduced"]
        assert [verdict] == expected, claim


def test_results_that_contradict_the_paper_do_not_reproduce_it(tmp_path: Path) -> None:
    the_contrary(tmp_path)
    for claim, verdict in verdicts(tmp_path).items():
        assert verdict == "not", claim


def test_linear_experts_have_verdicts_of_their_own(tmp_path: Path) -> None:
    as_the_paper_says(tmp_path)
    the_contrary(tmp_path / "contrary")
    (tmp_path / "contrary" / "paper").rename(tmp_path / "paper_linear")
    page = results.page(results.read_all(tmp_path), tmp_path)
    decided = sum(claim.sweep == FIGURE_2 for claims in CLAIMS.values() for claim in claims)
    assert (
        f"{decided} claims. With neural experts: {decided - 1} reproduced, 1 partly. "
        f"With linear experts: {decided} not."
    ) in page
    assert "| Swimmer | 362 | 362, 1.00 | 543, 1.50 |" in page


def test_half_is_partly() -> None:
    def claim(*holds: bool) -> Claim:
        checks = [Check(str(index), "x", value) for index, value in enumerate(holds)]
        return Claim("", "", lambda _: checks)

    nothing = Evidence({})
    assert judge(claim(True, True), nothing) == Finding("0 x; 1 x", "reproduced")
    assert judge(claim(True, False), nothing) == Finding("0 x; 1 x ✗", "partly")
    assert judge(claim(True, False, False), nothing).verdict == "not"
    five = judge(claim(True, True, True, True, False), nothing)
    assert five == Finding("4 of 5 hold; 4 x ✗", "partly")


def test_without_results_nothing_is_claimed(tmp_path: Path) -> None:
    assert set(verdicts(tmp_path).values()) == {"not yet run"}
    assert "52 claims: 52 not yet run." in results.page({}, tmp_path)


def test_a_missing_seed_leaves_the_claim_open(tmp_path: Path) -> None:
    claims = CLAIMS["Figure 2: Hopper"]
    claim = next(claim for claim in claims if claim.text.startswith("GAIL is comparable"))

    def verdict(statuses: list[str]) -> str:
        where = {"label": "GAIL", "env_id": HOPPER, "num_trajectories": 10}
        rows = [row(1.0, **where, seed=k, status=status) for k, status in enumerate(statuses)]
        write_sweep(tmp_path / "paper", rows)
        return judge(claim, Evidence(results.read_all(tmp_path))).verdict

    assert verdict(["done"] * 3) == "reproduced"
    assert verdict(["done"] * 2) == "not yet run"
    assert verdict(["done"] * 3 + ["failed: it diverged"]) == "not yet run"


def test_a_claim_needs_all_seeds_of_its_sweep() -> None:
    for name, number in NUM_SEEDS.items():
        spec = tomllib.loads((results.EXPERIMENTS / f"{name}.toml").read_text())
        for entry in spec["grid"]:
            assert len(entry.get("seeds", spec["seeds"])) == number


def test_times_of_different_machines_are_not_compared(tmp_path: Path) -> None:
    as_the_paper_says(tmp_path)
    path = tmp_path / "paper" / "timings.csv"
    lines = path.read_text().splitlines(keepends=True)
    moved = [
        line.replace("2 CPU cores", "a GPU") if line.startswith("ailsrs") else line
        for line in lines
    ]
    path.write_text("".join(moved))
    found = verdicts(tmp_path)
    assert [text for text, verdict in found.items() if verdict == "not yet run"] == [
        text for text in found if "Computationally efficient" in text
    ]


def test_add_notes_command_and_commit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    repository = tmp_path / "repository"
    spec = repository / "experiments" / "paper.toml"
    spec.parent.mkdir(parents=True)
    spec.write_text("")
    git = ["git", "-C", str(repository), "-c", "user.name=n", "-c", "user.email=e"]
    for command in (["init", "-q"], ["add", "."], ["commit", "-q", "-m", "m"]):
        subprocess.run([*git, *command], check=True)
    monkeypatch.setattr(results, "EXPERIMENTS", spec.parent)
    sweep = write_sweep(tmp_path / "sweep", [row(1.0)])
    target = tmp_path / "results"

    planned = {field.name: "a" for field in dataclasses.fields(Cell)}
    planned |= {"spec": {"env": "a", "seeds": [0]}, "all_settings": {}}
    cells = [planned, planned | {"name": "b"}]
    (sweep / "sweep.json").write_text(json.dumps({"cells": cells, "episodes": 1}))
    results.add("paper", sweep, "HEAD", target)
    note = json.loads((target / "paper" / "provenance.json").read_text())
    assert note["command"] == "ailsrs sweep experiments/paper.toml"
    (commit,) = note["commits"]
    assert len(commit) == 40
    assert (target / "paper" / "curves.csv").read_text() == (sweep / "curves.csv").read_text()
    page = results.page(results.read_all(target), target)
    origin = "`ailsrs sweep experiments/paper.toml` | 1 of 2 | mujoco | 2 CPU cores"
    assert f"| paper | {origin} | `{commit[:7]}` |" in page

    subprocess.run([*git, "commit", "-q", "--allow-empty", "-m", "later"], check=True)
    for _ in range(2):  # the newest commit is last and occurs once
        results.add("paper", sweep, "HEAD", target)
    commits = json.loads((target / "paper" / "provenance.json").read_text())["commits"]
    assert len(commits) == 2
    assert commits[0] == commit

    for name, commit in (("papers", "HEAD"), ("paper", "nothing")):
        with pytest.raises(UserError, match=f"{commit} is no commit here that has .*{name}.toml"):
            results.add(name, sweep, commit, target)
    (target / "paper" / "provenance.json").write_text("[]")
    with pytest.raises(UserError, match=r"provenance.json does not name a command"):
        results.page(results.read_all(target), target)


def test_the_page_follows_from_the_committed_results() -> None:
    assert results.page(results.read_all(results.RESULTS)) == results.PAGE.read_text()


def test_all_cells_of_a_condition_imitate_the_same_expert() -> None:
    """A normalised return of one means the same for all that a table compares."""
    found: dict[tuple[Any, ...], list[float]] = {}
    for name, sweep in results.read_all(results.RESULTS).items():
        for cell in sweep.done:
            number = cell.num_trajectories if cell.draw_from is None else None
            condition = name, cell.env_id, cell.demonstrations, number, cell.draw_from
            found.setdefault(condition, []).append(cell.expert_return)
    for condition, returns in found.items():
        assert max(returns) - min(returns) <= 1e-3 * max(returns), condition
