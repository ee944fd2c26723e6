"""The notebooks run from a clean kernel, with smaller parameters, and their outputs are stored."""

import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

from ailsrs_jax.errors import UserError
from ailsrs_jax.show.episodes.renderer import require_renderer

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
LARGEST = 600_000  # bytes of a notebook
# The replacements of the cell that is tagged "parameters".
QUICK = {
    "method": """
EPISODES, HORIZON = 2, 150
ADVERSARY_STEPS = [0, 3, 6]
SEARCH_STEPS, GRID = 3, 3
""",
    "quickstart": """
SETTINGS = {"num_iterations": 2, "num_directions": 4, "num_top_directions": 2}
SETTINGS |= {"num_evaluation_episodes": 2, "episode_length": 200}
EPISODES = 2
""",
    "your_own_task": """
SETTINGS = {"num_iterations": 2, "num_directions": 4, "num_top_directions": 2}
DEMONSTRATIONS, EPISODES = 2, 2
""",
}

every_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def read(path: Path) -> nbformat.NotebookNode:
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    return notebook


def tags(cell: nbformat.NotebookNode) -> list[str]:
    return cell.metadata.get("tags", [])


def outputs(notebook: nbformat.NotebookNode) -> list[nbformat.NotebookNode]:
    return [output for cell in notebook.cells for output in cell.get("outputs", [])]


def num_pictures(notebook: nbformat.NotebookNode) -> int:
    return sum("image/png" in output.get("data", {}) for output in outputs(notebook))


@pytest.mark.slow
@every_notebook
def test_it_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("TF_CPP_MIN_LOG_LEVEL", raising=False)  # JAX sets it in this process
    notebook = read(path)
    parameters = [cell for cell in notebook.cells if "parameters" in tags(cell)]
    assert len(parameters) == 1
    parameters[0].source = QUICK[path.stem]
    try:
        require_renderer()
    except UserError:  # the rest works without one
        notebook.cells = [cell for cell in notebook.cells if "video" not in tags(cell)]
    for cell in notebook.cells:
        if "video" in tags(cell):  # rendering is slow without a GPU
            cell.source = re.sub(r", seconds=2, size=\d+\)", ", seconds=0.2, size=64)", cell.source)
    NotebookClient(notebook, timeout=250, resources={"metadata": {"path": str(tmp_path)}}).execute()
    shown = outputs(notebook)
    assert not [output for output in shown if output.output_type == "error"]
    assert not [output.text for output in shown if output.get("name") == "stderr"]
    assert num_pictures(notebook) >= 2


@every_notebook
def test_its_outputs_are_stored(path: Path) -> None:
    """Of a whole run from top to bottom, without a warning, and without a path of a machine."""
    notebook = read(path)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
    assert {output.output_type for output in outputs(notebook)} <= {
        *("display_data", "execute_result", "stream")
    }
    assert num_pictures(notebook) >= 2
    assert path.stat().st_size < LARGEST
    shown = outputs(notebook)
    texts = [output.text for output in shown if "text" in output]
    texts += [
        content
        for output in shown
        for kind, content in output.get("data", {}).items()
        if kind.startswith("text/") and "base64," not in content
    ]
    for text in texts:
        assert not re.search(r"/(home|root|tmp|work|usr|content)/|[Ww]arning|Traceback", text), text
    assert not [output for output in shown if output.get("name") == "stderr"]


@every_notebook
def test_it_can_be_opened_in_colab(path: Path) -> None:
    """The badge opens this notebook, and the first cell installs the repository of the badge."""
    title, install = read(path).cells[0].source, read(path).cells[1].source
    (repository,) = re.findall(r'REPOSITORY = "https://github\.com/(.+/ailsrs_jax)"', install)
    assert 'pip install --quiet "ailsrs_jax @ git+{REPOSITORY}"' in install
    address = f"https://colab.research.google.com/github/{repository}/blob/main/notebooks/"
    assert f"({address}{path.name})" in title
    assert install == read(NOTEBOOKS[0]).cells[1].source


@every_notebook
def test_its_links_work(path: Path) -> None:
    for cell in read(path).cells:
        if cell.cell_type == "markdown":
            for link in re.findall(r"\]\(([^)#]+)[^)]*\)", cell.source):
                assert link.startswith("https:") or (path.parent / link).is_file(), link
