"""Figures of speed in the documentation are those of the committed measurements."""

import io
import json
import re
from operator import attrgetter
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from ailsrs_jax.cli.measure import print_benchmark
from ailsrs_jax.runs.benchmark.speed import Row
from experiments.peer import compare

ROOT = Path(__file__).parent.parent
MEASURED = ROOT / "experiments" / "speed"
TASK = "HalfCheetah-v5"


def measured(name: str) -> dict[str, Any]:
    return json.loads((MEASURED / name).read_text())


def page(name: str) -> str:
    return " ".join((ROOT / name).read_text().split())


def train_speed(name: str, engine: str) -> float:
    rows = measured(name)["rows"]
    (row,) = [row for row in rows if (row["physics"], row["stage"]) == (engine, "train")]
    return row["env_steps_per_s"]


def test_the_table_is_what_the_command_prints() -> None:
    console = Console(file=io.StringIO(), width=100)
    result = measured("halfcheetah.json")
    print_benchmark(console, [Row(**row) for row in result["rows"]], result["ratios"])
    printed = [line.strip() for line in console.file.getvalue().splitlines()]
    (table,) = re.findall(r"```\n(.*?)```", (ROOT / "docs" / "speed.md").read_text(), re.DOTALL)
    assert [line.strip() for line in table.splitlines()] == printed


def test_the_readme_says_how_fast_it_is() -> None:
    ratios = measured("halfcheetah.json")["ratios"]
    gymnasium, envpool = (
        ratios[f"{TASK} mujoco train / peer:{peer}"] for peer in ("gymnasium", "envpool")
    )
    assert (
        f"[{train_speed('halfcheetah.json', 'mujoco'):,.0f} steps/s](docs/speed.md) of "
        f"HalfCheetah while training on two cores, {gymnasium:.1f} times as many as Gymnasium's "
        f"environments make without training, {envpool:.2f} times EnvPool's"
    ) in page("README.md")


def test_what_a_second_device_gains() -> None:
    one, two = (train_speed(f"{number}.json", "mjx") for number in ("one_device", "two_devices"))
    assert f"{two:,.0f} steps/s on two devices and at {one:,.0f} on one" in page("docs/speed.md")


def test_what_stacking_gains() -> None:
    lines = (MEASURED / "stacking.txt").read_text().splitlines()
    alone, stacked = (re.search(r"([\d,]+) live steps/s", line)[1] for line in lines)  # type: ignore[index]
    share = float(re.search(r"time of a step ([\d.]+)", lines[-1])[1])  # type: ignore[index]
    assert f"takes {share:.2f} of the time of one cell's ({stacked} against {alone} live" in page(
        "docs/sweeps.md"
    )


def peer_runs(name: str) -> list[compare.Run]:
    content = json.loads((ROOT / "experiments" / "peer" / name).read_text())
    return [compare.Run(**run) for run in content["runs"]]


def cells(text: str) -> list[list[str]]:
    """What a row of a Markdown table says of its system, row by row; its name left out."""
    rows = [line.strip("| ").split(" | ") for line in text.splitlines() if " M, " in line]
    return [row[1:] for row in rows]


def test_the_tables_of_peers_are_what_the_command_prints(
    capsys: pytest.CaptureFixture[str],
) -> None:
    for name in ("hopper_ours.json", "hopper.json"):
        compare.print_table(peer_runs(name))
    section = (ROOT / "docs" / "speed.md").read_text().split("## Until a policy is there\n")[1]
    assert cells(section.split("\n## ")[0]) == cells(capsys.readouterr().out)


def test_the_readme_says_when_a_policy_is_there() -> None:
    def seconds(name: str, system: str) -> str:
        mine = [run for run in peer_runs(name) if run.system == system]
        return f"{compare.median(mine, 'seconds')[0]:.0f} s"

    theirs = [run for run in peer_runs("hopper.json") if run.system.startswith("imitation-")]
    there = min((run for run in theirs if run.reached), key=attrgetter("seconds"))
    readme = page("README.md")
    ours = "hopper_ours.json"
    assert f"at 0.9 of the expert in [{seconds(ours, 'ailsrs')}](docs/speed.md)" in readme
    assert f"a neural clone in {seconds(ours, 'gail')}, our GAIL" in readme
    assert f"from nothing, in {seconds(ours, 'gail-from-nothing')} (one seed not" in readme
    assert f"AILSRS's former preset took {seconds('hopper.json', 'ailsrs')}, the" in readme
    assert f"`imitation` package's takes {there.seconds:.0f} s at the earliest" in readme
