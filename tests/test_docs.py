"""The documentation builds, its commands can be parsed, and its links work."""

import functools
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tyro

import ailsrs_jax
from ailsrs_jax.cli.arguments import assignments
from ailsrs_jax.cli.main import app
from ailsrs_jax.data.demonstrations import load_demonstrations
from ailsrs_jax.data.policies import load_policy
from ailsrs_jax.trainers.algorithms import preset_settings
from ailsrs_jax.trainers.parts.settings import override, parse
from tests.cli.test_cli import TINY, ailsrs

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
OWN_TASK = ROOT / "docs" / "own_task.md"
OWN_ALGORITHM = ROOT / "docs" / "your_own_algorithm.md"

# Options that are added to each command so that it takes seconds.
SMALLER = {
    "expert": "--set num_iterations=2 num_directions=2 num_top_directions=1 episode_length=10",
    "demonstrate": "--num-trajectories 3",
    "train": f"--set num_iterations=2 {' '.join(TINY)}",
    "evaluate": "--episodes 2",
}


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(), re.DOTALL)


def test_plots_and_videos_need_no_extra_and_every_extra_that_is_named_exists() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    installed = {re.split(r"\W", each)[0] for each in project["dependencies"]}
    assert {"matplotlib", "av"} <= installed
    texts = (*PAGES, ROOT / "Dockerfile", *sorted((ROOT / "ailsrs_jax").rglob("*.py")))
    named = {
        extra
        for text in texts
        for group in re.findall(r"(?:ailsrs_jax|'\.|\$1)\[([a-z\d,]+)\]", text.read_text())
        for extra in group.split(",")
    }
    assert {"cuda12", "export", "minari"} <= named <= set(project["optional-dependencies"])


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The built site; a warning is an error."""
    output = tmp_path_factory.mktemp("site")
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "-W",
        "--keep-going",
        "-q",
        "-c",
        "docs",
        ".",
        output,
    ]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return output


def test_references_are_complete(site: Path) -> None:
    reference = (site / "docs" / "reference.html").read_text()
    for name in ailsrs_jax.__all__:
        assert f'id="ailsrs_jax.{name}"' in reference, name
    assert 'id="ailsrs_jax.AilsrsSettings.gradient_penalty"' in reference  # inherited
    command_line = (site / "docs" / "command_line.html").read_text()
    for command in app._subcommands:
        assert f"usage: ailsrs {command}" in command_line, command


def test_a_reader_needs_no_network(site: Path) -> None:
    pages = list(site.rglob("*.html"))
    assert len(pages) > 15
    for page in pages:
        loaded = re.findall(r"<(?:script|img|link)\b[^>]*(?:src|href)=\"(.*?)\"", page.read_text())
        assert not [url for url in loaded if ":" in url.split("?")[0]], page
    for sheet in site.rglob("*.css"):
        assert not re.search(r"url\(\W?(https?:)?//", sheet.read_text()), sheet


def test_formulas_are_mathml(site: Path) -> None:
    method = (site / "docs" / "method.html").read_text()
    source = (ROOT / "docs" / "method.md").read_text()
    assert method.count('<math xmlns="http://www.w3.org/1998/Math/MathML" display="block"') == (
        source.count("\n$$\n") // 2
    )
    assert "\\mathbb" not in method


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_can_be_typed(page: Path, in_tmp_path: Path) -> None:
    """Every command is parsed and its settings are looked up, but none is run."""
    if page == OWN_ALGORITHM:
        Path("my_file.py").write_text(blocks(page, "python")[0])
    parser = tyro.extras.SubcommandApp()
    for name, command in app._subcommands.items():
        parser.command(_parsed_only(command.target), name=name)
    for line in "".join(blocks(page, "sh")).splitlines():
        _, found, arguments = line.partition("ailsrs ")
        if not found or not arguments[0].isalpha():
            continue
        try:
            parser.cli(args=shlex.split(arguments, comments=True))
        except SystemExit:
            pytest.fail(line)


def _parsed_only(command: Any) -> Any:
    @functools.wraps(command)
    def check(*_: Any, **parsed: Any) -> None:
        if command.__name__ == "train":
            settings = preset_settings(parsed["env"], parsed["preset"], parsed["algorithm"])
            override(settings, parse(settings, assignments(parsed["settings"])))

    return check


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    """Sphinx does not check the links of pages as a code host shows them."""
    for link in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text()):
        assert (page.parent / link).exists(), link


@pytest.mark.slow
def test_a_task_of_ones_own(in_tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    Path("slider.xml").write_text(blocks(OWN_TASK, "xml")[0])
    Path("my_tasks.py").write_text(blocks(OWN_TASK, "python")[0])
    for line in blocks(OWN_TASK, "sh")[0].splitlines():
        program, command, *arguments = shlex.split(line)
        assert program == "ailsrs"
        assert ailsrs(monkeypatch, command, *arguments, *SMALLER[command].split()) == 0, line
    assert load_demonstrations("slider.npz").observations.shape == (3, 1000, 2)
    assert load_policy("runs/slider/seed_0/policy.npz").env_id == "my_tasks:Slider"
    *_, returns, length = capsys.readouterr().out.splitlines()[-1].split()
    assert length == "10"  # the run's
    assert np.isfinite(float(returns))

    assert ailsrs(monkeypatch, "evaluate", "runs/slider") == 2
    assert "Gymnasium has no my_tasks:Slider: choose physics auto" in capsys.readouterr().err
