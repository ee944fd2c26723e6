"""The notebooks run from a clean kernel, with smaller parameters."""

import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

from ailsrs_jax.errors import UserError
from ailsrs_jax.show.episodes.renderer import require_renderer

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
# The replacements of the cell that is tagged "parameters".
QUICK = {
    "quickstart": """
SETTINGS = {"num_iterations": 2, "num_directions": 4, "num_top_directions": 2}
SETTINGS |= {"num_evaluation_episodes": 2, "episode_length": 200}
EPISODES = 2
""",
    "reproduce_paper": f"""
TINY = {{"num_iterations": 1, "num_directions": 2, "num_top_directions": 1, "episode_length": 100}}
TINY |= {{"num_evaluation_episodes": 1}}
SPEC = {{
    "episodes": 2,
    "num_trajectories": 2,
    "seeds": [0, 1],
    "grid": [
        {{"env": "swimmer", "algorithm": "bc", "settings": {{"num_iterations": 1}}}},
        {{"env": "swimmer", "algorithm": "ailsrs", "settings": TINY}},
    ],
}}
CLONE = {str(ROOT)!r}
""",
    "your_own_task": "ITERATIONS, EPISODES, STEPS = 2, 5, 30",
}


def tags(cell: nbformat.NotebookNode) -> list[str]:
    return cell.metadata.get("tags", [])


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if path.stem == "your_own_task":
        pytest.importorskip("minari")
    monkeypatch.delenv("TF_CPP_MIN_LOG_LEVEL", raising=False)  # JAX sets it in this process
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "datasets"))
    notebook = nbformat.read(path, as_version=4)
    parameters = [cell for cell in notebook.cells if "parameters" in tags(cell)]
    assert len(parameters) == 1
    parameters[0].source = QUICK[path.stem]
    try:
        require_renderer()
    except UserError:  # the rest works without one
        notebook.cells = [cell for cell in notebook.cells if "video" not in tags(cell)]
    for cell in notebook.cells:
        if "video" in tags(cell):  # rendering is slow without a GPU
            cell.source = re.sub(r"(, seconds=4)?\)$", ", seconds=0.2, size=64)", cell.source)
    NotebookClient(notebook, timeout=250, resources={"metadata": {"path": str(tmp_path)}}).execute()
    shown = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert not [output for output in shown if output.output_type == "error"]
    if "quickstart" in path.stem:
        assert any("image/png" in output.get("data", {}) for output in shown)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_no_output_is_committed(path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    for cell in notebook.cells:
        if cell.cell_type == "code":
            assert (cell.outputs, cell.execution_count) == ([], None)
