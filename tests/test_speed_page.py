"""The speeds in the documentation are those of the committed measurements."""

import io
import json
import re
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


def test_the_page_has_the_table_that_the_command_prints() -> None:
    console = Console(file=io.StringIO(), width=100)
    result = measured("halfcheetah.json")
    print_benchmark(console, [Row(**row) for row in result["rows"]], result["ratios"])
    printed = [line.strip() for line in console.file.getvalue().splitlines()]
    (table,) = re.findall(r"```\n(.*?)```", (ROOT / "docs" / "speed.md").read_text(), re.DOTALL)
    assert [line.strip() for line in table.splitlines()] == printed


def test_the_speed_in_the_readme() -> None:
    ratios = measured("halfcheetah.json")["ratios"]
    gymnasium, envpool = (
        ratios[f"{TASK} mujoco train / peer:{peer}"] for peer in ("gymnasium", "envpool")
    )
    assert (
        f"[{train_speed('halfcheetah.json', 'mujoco'):,.0f} steps/s](docs/speed.md) of "
        f"HalfCheetah while training on two cores. That is {gymnasium:.1f} times the speed of "
        f"Gymnasium's environments without training, and {envpool:.2f} times EnvPool's."
    ) in page("README.md")


def test_the_gain_of_a_second_device() -> None:
    one, two = (train_speed(f"{number}.json", "mjx") for number in ("one_device", "two_devices"))
    assert f"{two:,.0f} steps/s on two devices and at {one:,.0f} on one" in page("docs/speed.md")


def test_the_gain_of_stacking() -> None:
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
    """The rows of a Markdown table without the name of the system."""
    rows = [line.strip("| ").split(" | ") for line in text.splitlines() if " M, " in line]
    return [row[1:] for row in rows]


def test_the_page_has_the_tables_of_peers_that_the_command_prints(
    capsys: pytest.CaptureFixture[str],
) -> None:
    for name in ("hopper_ours.json", "hopper.json"):
        compare.print_table(peer_runs(name))
    section = (ROOT / "docs" / "speed.md").read_text().split("## Time to a policy\n")[1]
    assert cells(section.split("\n## ")[0]) == cells(capsys.readouterr().out)


def test_the_times_to_a_policy_in_the_readme() -> None:
    def seconds(system: str) -> str:
        mine = [run for run in peer_runs("hopper_ours.json") if run.system == system]
        return f"{compare.median(mine, 'seconds')[0]:.0f} s"

    readme = page("README.md")
    assert f"0.9 of the expert is [{seconds('ailsrs')}](docs/speed.md) for AILSRS" in readme
    assert f"{seconds('gail')} for a neural clone" in readme
    assert f"{seconds('gail-from-nothing')} for our GAIL without a clone" in readme
